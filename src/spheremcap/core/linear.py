"""Small systems, products and medians for compiled loops."""

from spheremcap.core.compiled import finite, inner


@inner
def inverse3(a, out):
    """The inverse of a symmetric (3, 3) matrix into `out`; its determinant, 0 or NaN when there is no inverse."""
    c00 = a[1, 1] * a[2, 2] - a[1, 2] * a[1, 2]
    c01 = a[0, 2] * a[1, 2] - a[0, 1] * a[2, 2]
    c02 = a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]
    det = a[0, 0] * c00 + a[0, 1] * c01 + a[0, 2] * c02
    if det == 0.0 or not finite(det):
        return 0.0
    out[0, 0] = c00 / det
    out[0, 1] = out[1, 0] = c01 / det
    out[0, 2] = out[2, 0] = c02 / det
    out[1, 1] = (a[0, 0] * a[2, 2] - a[0, 2] * a[0, 2]) / det
    out[1, 2] = out[2, 1] = (a[0, 1] * a[0, 2] - a[0, 0] * a[1, 2]) / det
    out[2, 2] = (a[0, 0] * a[1, 1] - a[0, 1] * a[0, 1]) / det
    return det


@inner
def product(a, b, out):
    """The matrix product a b into `out`, which is neither of them."""
    for i in range(a.shape[0]):
        for j in range(b.shape[1]):
            out[i, j] = 0.0
            for k in range(a.shape[1]):
                out[i, j] += a[i, k] * b[k, j]


@inner
def solve(a, b):
    """The solution x of a x = b into `b` (n, m), for a symmetric positive definite `a` (n, n), which is used up."""
    size = a.shape[0]
    for k in range(size):  # elimination needs no pivots where every pivot is positive
        for i in range(k + 1, size):
            share = a[i, k] / a[k, k]
            for j in range(k + 1, size):
                a[i, j] -= share * a[k, j]
            for j in range(b.shape[1]):
                b[i, j] -= share * b[k, j]
    for k in range(size - 1, -1, -1):
        for j in range(b.shape[1]):
            for i in range(k + 1, size):
                b[k, j] -= a[k, i] * b[i, j]
            b[k, j] /= a[k, k]


@inner
def middle(values, count):
    """The upper median of the first `count` values; they are reordered (Hoare's selection)."""
    wanted, low, high = count // 2, 0, count - 1
    while low < high:
        pivot = values[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if wanted <= j:
            high = j
        elif wanted >= i:
            low = i
        else:
            break
    return values[wanted]
