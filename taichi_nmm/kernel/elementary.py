"""Sine, cosine, arctangent, exponential, hash from arithmetic alone, so that lanes vectorise.

Library functions are calls, and a call stops LLVM's loop vectoriser. Accurate to some
1e-15 in float64 and to rounding in float32 over the ranges named; tested against NumPy.
"""

from math import factorial, log

from taichi_nmm.kernel import backend, compiler
from taichi_nmm.kernel.backend import Rows, Static, ti

TWO_OVER_PI = 0.6366197723675814
# pi/2 in two parts (Cody & Waite): the first has few bits, so that k times it is exact.
HALF_PI_HIGH = 1.5703125
HALF_PI_LOW = 4.838267948966190e-4
HALF_PI = 1.5707963267948966

LEAST_SQUARE = 1e-30  # normal in float32
LOG2_E = 1.4426950408889634

# Taylor coefficients, highest power first; sine and cosine in powers of the square.
SINE = tuple((-1) ** k / factorial(2 * k + 1) for k in reversed(range(8)))
COSINE = tuple((-1) ** k / factorial(2 * k) for k in reversed(range(8)))
EXPONENTIAL = tuple(log(2.0) ** k / factorial(k) for k in reversed(range(12)))  # of 2^x

# Cephes, atan.c: atan u = u + u z P(z)/Q(z) with z = u^2, for |u| <= 0.66.
ARCTANGENT_P = (
    -8.750608600031904122785e-1,
    -1.615753718733365076637e1,
    -7.500855792314704667340e1,
    -1.228866684490136173410e2,
    -6.485021904942025371773e1,
)
ARCTANGENT_Q = (
    1.0,
    2.485846490142306297962e1,
    1.650270098316988542046e2,
    4.328810604912902668951e2,
    4.853903996359136964868e2,
    1.945506571482613964425e2,
)

# Weyl's increment 2^32 / golden ratio, and the rounds of `lowbias32` (C. Wellons,
# 2018).
INCREMENT, FIRST_FACTOR, SECOND_FACTOR = 0x9E3779B9, 0x7FEB352D, 0x846CA68B
TICK_FACTOR = 0x85EBCA6B  # odd: no two ticks share their noise


def terms(coefficients: tuple[float, ...], single: int) -> tuple[float, ...]:
    """All of a series in float64, its last `single` terms in float32: the rest rounds away."""
    return coefficients if backend.is_double() else coefficients[-single:]


@ti.func
def larger(x, y):
    """The larger of both, and x where y is NaN: one instruction, where `ti.max` takes three."""
    return ti.select(y > x, y, x)


@ti.func
def smaller(x, y):
    """The smaller of both, and x where y is NaN."""
    return ti.select(y < x, y, x)


@ti.func
def square_root(x):
    """Of 0 or more. On a GPU by one instruction and a product, where `ti.sqrt` calls a function."""
    root = x
    if ti.static(compiler.unrolls):
        root *= ti.rsqrt(larger(x, LEAST_SQUARE))
    else:
        root = ti.sqrt(x)
    return root


@ti.func
def latch(row: Rows, lane, condition, value):
    """Remember `value` in a row where `condition` holds."""
    row[lane] = ti.select(condition, value, row[lane])


@ti.func
def polynomial(x, coefficients: Static):
    """Horner's rule; `coefficients` is a tuple of two or more, highest power first."""
    value = coefficients[0] * x + coefficients[1]
    for coefficient in ti.static(coefficients[2:]):
        value = value * x + coefficient
    return value


@ti.func
def sine_cosine(x):
    """(sin x, cos x) for |x| up to some hundred turns: Taylor series within +-pi/4."""
    k = ti.floor(x * TWO_OVER_PI + 0.5)
    r = (x - k * HALF_PI_HIGH) - k * HALF_PI_LOW
    z = r * r
    sine = r * polynomial(z, ti.static(terms(SINE, 5)))
    cosine = polynomial(z, ti.static(terms(COSINE, 6)))
    quarter = k - 4.0 * ti.floor(0.25 * k)  # 0, 1, 2 or 3
    odd = (quarter == 1.0) | (quarter == 3.0)
    s = ti.select(odd, cosine, sine)
    c = ti.select(odd, sine, cosine)
    s = ti.select(quarter > 1.5, 0.0 - s, s)
    c = ti.select((quarter == 1.0) | (quarter == 2.0), 0.0 - c, c)
    return s, c


@ti.func
def arctangent2(y, x):
    """Angle of the point (x, y) in (-pi, pi]; the rational approximation of Cephes' atan."""
    ax = larger(x, 0.0 - x)
    ay = larger(y, 0.0 - y)
    t = smaller(ax, ay) / larger(larger(ax, ay), 1e-30)
    reduced = t > 0.66
    u = ti.select(reduced, (t - 1.0) / (t + 1.0), t)
    z = u * u
    angle = u + u * z * polynomial(z, ARCTANGENT_P) / polynomial(z, ARCTANGENT_Q)
    angle += ti.select(reduced, 0.5 * HALF_PI, 0.0)
    angle = ti.select(ay > ax, HALF_PI - angle, angle)
    angle = ti.select(x < 0.0, 2.0 * HALF_PI - angle, angle)
    return ti.select(y < 0.0, 0.0 - angle, angle)


@ti.func
def two_to(x):
    """2^x, x clamped to [-120, 120], NaN to -120: a whole power, times the series of the rest."""
    clamped = smaller(larger(-120.0, x), 120.0)
    k = ti.floor(clamped + 0.5)
    return polynomial(clamped - k, ti.static(terms(EXPONENTIAL, 8))) * power_of_two(k)


@ti.func
def power_of_two(k):
    """2^k for a whole k in the exponent's range: k goes straight into the exponent's bits."""
    power = 0.0
    if ti.static(backend.is_double()):
        power = ti.bit_cast((ti.cast(k, ti.i64) + 1023) << 52, ti.f64)
    else:
        power = ti.bit_cast((ti.cast(k, ti.i32) + 127) << 23, ti.f32)
    return power


@ti.func
def uniform(word):
    """A number in [-1, 1) from a word of 32 bits."""
    word ^= word >> ti.u32(16)
    word *= ti.u32(FIRST_FACTOR)
    word ^= word >> ti.u32(15)
    word *= ti.u32(SECOND_FACTOR)
    word ^= word >> ti.u32(16)
    return ti.cast(ti.cast(word >> ti.u32(8), ti.i32), float) * 2.0**-23 - 1.0
