"""What the bits of a float give cheaply: scaling by powers of two, exponents, rough powers."""

from __future__ import annotations

from robodyn.engines.assembler import Kernel, Word

_MANTISSA = 52
_BIAS = 1023


def exponent(kernel: Kernel, x: Word) -> Word:
    """n of |x| = f 2^n with 1 <= f < 2, as whole numbers; -1023 of zero."""
    bits = kernel.convert("bitcast", kernel.intrinsic("fabs", x), kernel.wholes)
    shifted = kernel.binary("lshr", bits, kernel.whole_lanes(_MANTISSA))
    return kernel.subtract(shifted, kernel.whole_lanes(_BIAS))


def scaled(kernel: Kernel, x: Word, n: Word) -> Word:
    """x 2^n for whole n; x and the result neither zero nor out of the usual range."""
    bits = kernel.convert("bitcast", x, kernel.wholes)
    moved = kernel.binary("shl", n, kernel.whole_lanes(_MANTISSA))
    return kernel.convert("bitcast", kernel.add(bits, moved), kernel.numbers)


def rough_power(kernel: Kernel, x: Word, exponent: float) -> Word:
    """x^exponent of x >= 0 within 7 % for |exponent| <= 1, without a logarithm.

    The bits of x, read as a whole number, are its logarithm to base 2, but for a scale, a shift
    and 9 % of one.  Zero counts as 2^-1023; nan and infinity give nan.
    """
    k, one = kernel, float(2**_MANTISSA)
    whole = k.convert("sitofp", k.convert("bitcast", x, k.wholes), k.numbers)
    shift = _BIAS * one * (1.0 - exponent)
    power = k.add(k.multiply(whole, k.number(exponent)), k.number(shift))
    found = k.convert("bitcast", k.convert("fptosi", power, k.wholes), k.numbers)
    return k.add(found, k.multiply(k.number(0.0), x))
