# type: ignore
# Kernels are written in Warp's language, which a checker of Python misreads.
"""Newton's linear system: factorise and solve a band with a border, one world a thread."""

import warp as wp

from services.simulator.arrays import DIRECTION, Rigid, System, Worlds
from services.simulator.device import MODULE

PANEL = 4
"""Rows that are eliminated together: each target row is then read and written once instead of four times."""

SOLVE = """
    const int MOST_COLUMNS = 192;  // six for each of the 32 bodies that the contact search can tell apart

    // U^T U of the band, right-looking; the right-hand side and the border are further columns of every row.
    const int PANEL = 4;
    float* const A = bordered.data + (long long)w * n * row;
    // Border columns of bodies that touch nothing soft are zeros: the others are moved together.
    int column[MOST_COLUMNS];
    int width_of_border = 0;
    for (int b = 0; b + 6 <= m; b += 6) {
        bool used = false;
        for (int i = 0; i < n && !used; ++i) {
            const float* const entry = A + (long long)i * row + band + 1 + b;
            for (int c = 0; c < 6; ++c) used = used || entry[c] != 0.0f;
        }
        for (int c = 0; used && c < 6; ++c) column[width_of_border++] = b + c;
    }
    for (int i = 0; i < n; ++i) {
        float* const border = A + (long long)i * row + band + 1;
        for (int c = 0; c < width_of_border; ++c) border[c] = border[column[c]];
    }
    const int right = band + 1 + width_of_border;
    for (int k0 = 0; k0 < n; k0 += PANEL) {
        const int size = n - k0 < PANEL ? n - k0 : PANEL;
        bool coupled = false;
        for (int p = 0; p < size; ++p) {
            float* __restrict__ const target = A + (long long)(k0 + p) * row;
            for (int o = 0; o < p; ++o) {
                const float* __restrict__ const source = A + (long long)(k0 + o) * row;
                const float factor = source[p - o];
                for (int d = 0; d < band - PANEL; ++d) target[d] -= factor * source[d + p - o];
                for (int c = band; c < right; ++c) target[c] -= factor * source[c];
            }
            const float pivot = target[0] > 1e-12f ? target[0] : 1e-12f;
            const float scale = 1.0f / sqrtf(pivot);
            for (int d = 0; d < right; ++d) target[d] *= scale;
            for (int c = band + 1; c < right; ++c) coupled = coupled || target[c] != 0.0f;
        }
        const int end = coupled ? right : band + 1;
        const float* __restrict__ const r0 = A + (long long)k0 * row;
        const float* __restrict__ const r1 = r0 + (size > 1 ? row : 0);
        const float* __restrict__ const r2 = r0 + (size > 2 ? 2 * row : 0);
        const float* __restrict__ const r3 = r0 + (size > 3 ? 3 * row : 0);
        const int reach = band - PANEL;  // half-bandwidth; the entries behind it are zeros
        for (int i = k0 + size; i < n && i < k0 + size + reach; ++i) {
            float* __restrict__ const target = A + (long long)i * row;
            const int s = i - k0;
            const float a0 = r0[s];
            const float a1 = size > 1 ? r1[s - 1] : 0.0f;
            const float a2 = size > 2 ? r2[s - 2] : 0.0f;
            const float a3 = size > 3 ? r3[s - 3] : 0.0f;
            const int width = reach - s + size;
            const float* __restrict__ const s0 = r0 + s;
            const float* __restrict__ const s1 = r1 + (size > 1 ? s - 1 : 0);
            const float* __restrict__ const s2 = r2 + (size > 2 ? s - 2 : 0);
            const float* __restrict__ const s3 = r3 + (size > 3 ? s - 3 : 0);
            for (int d = 0; d < width; ++d) target[d] -= a0 * s0[d] + a1 * s1[d] + a2 * s2[d] + a3 * s3[d];
            for (int c = band; c < end; ++c) target[c] -= a0 * r0[c] + a1 * r1[c] + a2 * r2[c] + a3 * r3[c];
        }
        if (coupled) {
            for (int p = 0; p < size; ++p) {
                const float* __restrict__ const load = A + (long long)(k0 + p) * row + band;
                const float* __restrict__ const border = load + 1;
                for (int a = 0; a < width_of_border; ++a) {
                    if (border[a] == 0.0f) continue;
                    float* __restrict__ const target = corner.data + ((long long)w * m + column[a]) * m;
                    for (int b = a; b < width_of_border; ++b) target[column[b]] -= border[a] * border[b];
                    corner_load.data[w * m + column[a]] -= border[a] * load[0];
                }
            }
        }
    }
    // The bodies' dense corner, the same way.
    float* const C = corner.data + (long long)w * m * m;
    float* const y = corner_load.data + (long long)w * m;
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
    // Back substitution; eight partial sums let the compiler use vectors.
    float shift[MOST_COLUMNS];
    for (int c = 0; c < width_of_border; ++c) shift[c] = y[column[c]];
    float* const x = (float*)direction.data + (long long)w * n;
    for (int k = n - 1; k >= 0; --k) {
        const float* __restrict__ const source = A + (long long)k * row;
        const int length = n - 1 - k < band - PANEL ? n - 1 - k : band - PANEL;
        float sums[8] = {0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
        int d = 0;
        for (; d + 8 <= length; d += 8)
            for (int l = 0; l < 8; ++l) sums[l] += source[1 + d + l] * x[k + 1 + d + l];
        float sum = source[band];
        for (; d < length; ++d) sum -= source[1 + d] * x[k + 1 + d];
        for (int c = 0; c < width_of_border; ++c) sum -= source[band + 1 + c] * shift[c];
        for (int l = 0; l < 8; ++l) sum -= sums[l];
        x[k] = sum / source[0];
    }
"""


@wp.func_native(SOLVE)
def solve_bordered_band(
    bordered: wp.array2d[float],
    corner: wp.array3d[float],
    corner_load: wp.array2d[float],
    direction: wp.array2d[wp.vec3],
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
