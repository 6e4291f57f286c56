"""How far a description of state and action lies from those of the training data."""

import torch
from torch import Tensor

SHRINKAGE = 0.1
"""Share of the mean variance in the covariance, so that it can be inverted [-]."""


def whitening(descriptions: Tensor) -> tuple[Tensor, Tensor]:
    """Return mean ``(F,)`` and whitening matrix ``(F, F)`` of descriptions ``(N, F)``.

    With the shrunk covariance ``S = L L^T`` the matrix is ``L^-1``; the rows of ``(x - mean) L^-T`` are white.
    """
    values = descriptions.double()
    mean = values.mean(dim=0)
    covariance = torch.cov(values.T)
    scale = covariance.diagonal().mean()
    shrunk = (1 - SHRINKAGE) * covariance + SHRINKAGE * scale * torch.eye(len(mean), dtype=values.dtype)
    inverse = torch.linalg.inv(torch.linalg.cholesky(shrunk))
    return mean.float(), inverse.float()


def mahalanobis(descriptions: Tensor, mean: Tensor, whiten: Tensor) -> Tensor:
    """Return the Mahalanobis distances ``(B,)`` of descriptions ``(B, F)``."""
    return torch.linalg.vector_norm((descriptions - mean) @ whiten.T, dim=1)
