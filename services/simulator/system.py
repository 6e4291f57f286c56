# type: ignore
# Kernels are written in Warp's language, which a checker of Python misreads.
"""Newton's linear system: factorise and solve a band with a border, one world a thread."""

import warp as wp

from services.simulator.arrays import DIRECTION, Rigid, System, Worlds
from services.simulator.device import MODULE

PADDING = 24
"""Zeros kept behind the band of every row: the rows eliminated together and one vector."""
VECTOR = 16
"""Entries to which the border of a row is padded; as many again are left free behind it."""

SOLVE = """
    const int MOST_COLUMNS = 192;  // six for each of the 32 bodies that the contact search can tell apart
#ifdef __CUDACC__
    typedef float vec;
    const int LANES = 1;
#else
    typedef float vec __attribute__((vector_size(64), aligned(4)));
    const int LANES = 16;
#endif
    const int PANEL = 8;  // rows that are eliminated together: every other row is read and written once for all
    const int reach = band - 24;  // half-bandwidth; the entries behind it are zeros
    float* const A = bordered.data + (long long)w * n * row;

    // Border columns of bodies that touch nothing soft are zeros: the others are moved together.
    int column[MOST_COLUMNS];
    int width = 0;
    for (int b = 0; b + 6 <= m; b += 6) {
        bool used = false;
        for (int i = 0; i < n && !used; ++i) {
            const float* const entry = A + (long long)i * row + band + 1 + b;
            for (int c = 0; c < 6; ++c) used = used || entry[c] != 0.0f;
        }
        for (int c = 0; used && c < 6; ++c) column[width++] = b + c;
    }
    const int right = band + (width + LANES) / LANES * LANES;  // the load and the border, padded
    for (int i = 0; i < n; ++i) {
        float* const border = A + (long long)i * row + band + 1;
        if (width < m)
            for (int c = 0; c < width; ++c) border[c] = border[column[c]];
        for (int c = band + 1 + width; c < right; ++c) A[(long long)i * row + c] = 0.0f;
    }
    const int stride = right - band;  // row a of the Schur complement: the load, then the columns
    float* const S = schur.data + (long long)w * schur.shape[1];
    for (int k = 0; k < width * stride; ++k) S[k] = 0.0f;

    // U^T U of the band, right-looking; the right-hand side and the border are further columns of every row.
    int first_coupled = n;
    for (int k0 = 0; k0 < n; k0 += PANEL) {
        const int size = n - k0 < PANEL ? n - k0 : PANEL;
        const float* source[PANEL];
        for (int p = 0; p < size; ++p) {
            float* const target = A + (long long)(k0 + p) * row;
            source[p] = target - p;  // equal columns have equal indices
            for (int o = 0; o < p; ++o) {
                const float factor = source[o][p];
                for (int d = 0; d < reach; d += LANES) *(vec*)(target + d) -= factor * *(const vec*)(source[o] + p + d);
                for (int c = band; c < right; c += LANES)
                    *(vec*)(target + c) -= factor * *(const vec*)(source[o] + o + c);
            }
            const float scale = 1.0f / sqrtf(target[0] > 1e-12f ? target[0] : 1e-12f);
            for (int d = 0; d < reach; d += LANES) *(vec*)(target + d) *= scale;
            for (int c = band; c < right; c += LANES) *(vec*)(target + c) *= scale;
            for (int c = band + 1; c < right && first_coupled == n; ++c)
                if (target[c] != 0.0f) first_coupled = k0 + p;
        }
        const bool coupled = first_coupled < n;
        const int end = coupled ? right : band + LANES;
        const int last = n - k0 < PANEL + reach ? n - k0 : PANEL + reach;
        int s = PANEL;
        for (; s + 2 <= last; s += 2) {
            float* const upper = A + (long long)(k0 + s) * row;
            float* const lower = upper + row;
            float a[PANEL], b[PANEL];
            for (int p = 0; p < PANEL; ++p) a[p] = source[p][s];
            for (int p = 0; p < PANEL; ++p) b[p] = source[p][s + 1];
            for (int d = 0; d < reach - s + PANEL; d += LANES) {
                vec first = *(const vec*)(upper + d);
                vec second = *(const vec*)(lower - 1 + d);
                for (int p = 0; p < PANEL; ++p) {
                    const vec entries = *(const vec*)(source[p] + s + d);
                    first -= a[p] * entries;
                    second -= b[p] * entries;
                }
                *(vec*)(upper + d) = first;
                *(vec*)(lower - 1 + d) = second;
            }
            for (int c = band; c < end; c += LANES) {
                vec first = *(const vec*)(upper + c);
                vec second = *(const vec*)(lower + c);
                for (int p = 0; p < PANEL; ++p) {
                    const vec entries = *(const vec*)(source[p] + p + c);
                    first -= a[p] * entries;
                    second -= b[p] * entries;
                }
                *(vec*)(upper + c) = first;
                *(vec*)(lower + c) = second;
            }
        }
        for (; s < last; ++s) {
            float* const target = A + (long long)(k0 + s) * row;
            for (int p = 0; p < size; ++p) {
                const float factor = source[p][s];
                for (int d = 0; d < reach - s + PANEL; d += LANES)
                    *(vec*)(target + d) -= factor * *(const vec*)(source[p] + s + d);
                for (int c = band; c < end; c += LANES)
                    *(vec*)(target + c) -= factor * *(const vec*)(source[p] + p + c);
            }
        }
        for (int a = 0; coupled && a < width; ++a) {
            for (int p = 0; p < size; ++p) {
                const float* const border = source[p] + p + band;
                const float factor = border[1 + a];
                if (factor == 0.0f) continue;
                for (int c = 0; c < stride; c += LANES)
                    *(vec*)(S + a * stride + c) -= factor * *(const vec*)(border + c);
            }
        }
    }
    // The bodies' dense corner, the same way.
    float* const C = corner.data + (long long)w * m * m;
    float* const y = corner_load.data + (long long)w * m;
    for (int a = 0; a < width; ++a) {
        y[column[a]] += S[a * stride];
        for (int b = a; b < width; ++b) C[(long long)column[a] * m + column[b]] += S[a * stride + 1 + b];
    }
    for (int k = 0; k < m; ++k) {
        float* __restrict__ const source = C + (long long)k * m;
        const float pivot = source[k] > 1e-12f ? source[k] : 1e-12f;
        const float scale = 1.0f / sqrtf(pivot);
        for (int b = k; b < m; ++b) source[b] *= scale;
        y[k] *= scale;
        for (int a = k + 1; a < m; ++a) {
            const float factor = source[a];
            if (factor == 0.0f) continue;
            float* __restrict__ const target = C + (long long)a * m;
            for (int b = a; b < m; ++b) target[b] -= factor * source[b];
            y[a] -= factor * y[k];
        }
    }
    for (int k = m - 1; k >= 0; --k) {
        float sum = y[k];
        for (int b = k + 1; b < m; ++b) sum -= C[k * m + b] * y[b];
        y[k] = sum / C[k * m + k];
    }
    // Back substitution; several partial sums let the compiler use vectors.
    float shift[MOST_COLUMNS];
    for (int c = 0; c < width; ++c) shift[c] = y[column[c]];
    float* const x = (float*)direction.data + (long long)w * n;
    for (int k = n - 1; k >= 0; --k) {
        const float* const entries = A + (long long)k * row;
        const int length = n - 1 - k < reach ? n - 1 - k : reach;
        float sums[16] = {};
        int d = 0;
        for (; d + 16 <= length; d += 16)
            for (int l = 0; l < 16; ++l) sums[l] += entries[1 + d + l] * x[k + 1 + d + l];
        float sum = entries[band];
        for (; d < length; ++d) sum -= entries[1 + d] * x[k + 1 + d];
        for (int c = 0; c < width; ++c) sum -= entries[band + 1 + c] * shift[c];
        for (int l = 0; l < 16; ++l) sum -= sums[l];
        x[k] = sum / entries[0];
    }
"""


@wp.func_native(SOLVE)
def solve_bordered_band(
    bordered: wp.array2d[float],
    corner: wp.array3d[float],
    corner_load: wp.array2d[float],
    direction: wp.array2d[wp.vec3],
    schur: wp.array2d[float],
    w: int,
    n: int,
    m: int,
    band: int,
    row: int,
):
    """Solve ``[[A, B^T], [B, C]] [x, y] = [f, g]`` in place for world ``w``.

    ``A`` is a symmetric positive definite band of ``n`` rows, ``C`` dense ``m`` x ``m``: Cholesky of ``A`` carries the
    border along, ``C - B A^-1 B^T`` is factorised densely, both are substituted back. ``x`` goes to ``direction``,
    ``y`` to ``corner_load``.
    """
    ...


@wp.kernel(module=MODULE)
def solve_newton(rigid: Rigid, worlds: Worlds, system: System):
    """Find Newton's direction for nodes and bodies."""
    w = wp.tid()
    if worlds.phase[w] != DIRECTION:
        return
    solve_bordered_band(
        system.bordered,
        system.corner,
        system.corner_load,
        worlds.d,
        system.schur,
        w,
        3 * system.nodes,
        6 * rigid.bodies,
        system.band,
        system.row,
    )
    for b in range(rigid.bodies):
        worlds.pd[w, b] = wp.vec3(
            system.corner_load[w, 6 * b], system.corner_load[w, 6 * b + 1], system.corner_load[w, 6 * b + 2]
        )
        worlds.qd[w, b] = wp.vec3(
            system.corner_load[w, 6 * b + 3], system.corner_load[w, 6 * b + 4], system.corner_load[w, 6 * b + 5]
        )
