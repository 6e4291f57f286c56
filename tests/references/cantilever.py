"""Make ``cantilever.json``: tip deflections of clamped beams under their own weight, by scikit-fem.

Run with ``pip install scikit-fem``; the stored numbers are what the tests compare with. Quadratic hexahedra
(27 nodes), small strain, ``z = 0`` clamped.
"""

import json
from pathlib import Path

import numpy as np
import skfem
from skfem.helpers import ddot, eye, sym_grad, trace

LENGTH, EDGE = 0.14, 0.02
DENSITY, GRAVITY, YOUNGS_MODULUS = 1050.0, 9.81, 1e6


def tip_deflection(poisson_ratio: float, along: int, across: int) -> float:
    """Return the mean deflection of the free end [m] of a beam 14 x 2 x 2 cm."""
    points = (np.linspace(0, LENGTH, along + 1), *(np.linspace(0, EDGE, across + 1),) * 2)
    basis = skfem.Basis(skfem.MeshHex.init_tensor(*points), skfem.ElementVector(skfem.ElementHex2()))
    shear = YOUNGS_MODULUS / (2 * (1 + poisson_ratio))
    lame = YOUNGS_MODULUS * poisson_ratio / ((1 + poisson_ratio) * (1 - 2 * poisson_ratio))

    @skfem.BilinearForm
    def elasticity(u, v, _):
        strain = sym_grad(u)
        return ddot(2 * shear * strain + lame * eye(trace(strain), 3), sym_grad(v))

    @skfem.LinearForm
    def weight(v, _):
        return -DENSITY * GRAVITY * v[2]

    clamped = basis.get_dofs(lambda x: np.isclose(x[0], 0))
    solution = skfem.solve(*skfem.condense(elasticity.assemble(basis), weight.assemble(basis), D=clamped))
    free = basis.get_dofs(lambda x: np.isclose(x[0], LENGTH))
    return -float(solution[free.nodal["u^3"]].mean())


if __name__ == "__main__":
    results = {f"{ratio:g}": tip_deflection(ratio, 14, 2) for ratio in (0.3, 0.45)}
    coarser = {f"{ratio:g}": tip_deflection(ratio, 7, 1) for ratio in (0.3, 0.45)}
    record = {"program": f"scikit-fem {skfem.__version__}", "deflection_m": results, "half_the_cells_m": coarser}
    Path(__file__).with_suffix(".json").write_text(json.dumps(record, indent=2) + "\n")
