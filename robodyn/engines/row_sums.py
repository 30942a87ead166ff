"""Sums over rows of coefficients in machine code, of many columns side by side."""

from __future__ import annotations

from robodyn.engines.assembler import Kernel, Module, Word, scalar

WIDE = 32  # most numbers that a sum takes at a time: what stands beside a run may be read


def sum_rows(
    k: Kernel,
    x: Word,
    y: Word,
    out: Word,
    terms: Word,
    wide: int,
    first: int,
    slope: float,
    level: Word,
) -> None:
    """Of so many columns: the sum of (slope j + level) x_j y_j from `first` on, y downward."""
    rest = f"{terms}, i64 {wide * k.lanes}"
    if slope:
        level = k.lane(k.add(level, k.number(slope * first)), 0)
        rest += f", {level}, double {scalar(slope)}"
    k.line(f"call void @{'weigh' if slope else 'convolve'}({x}, {y}, {out}, {rest})")


def width(lanes: int) -> int:
    """How many numbers a sum takes at a time: of several columns, as each waits for its terms."""
    return max(8, 4 * lanes)


def write_sums(module: Module, columns: int) -> None:
    """The functions that `sum_rows` calls, of rows of so many columns."""
    step, size = columns * module.lanes, width(module.lanes)
    vector = f"<{size} x double>"
    for name in ("convolve", "weigh"):
        weighs = name == "weigh"
        weights = ", double %level, double %slope" * weighs
        weight = "  %w = phi double [ %level, %begin ], [ %w1, %term ]\n" * weighs
        weighed = (
            f"""  %first = insertelement {vector} poison, double %w, i64 0
  %all = shufflevector {vector} %first, {vector} poison, <{size} x i32> zeroinitializer
  %a = fmul {vector} %a0, %all
  %w1 = fadd double %w, %slope
"""
            if weighs
            else ""
        )
        module.functions[name] = f"""\
define void @{name}(ptr %x, ptr %y, ptr %out, i64 %terms, i64 %wide{weights}) nounwind {{
entry:
  br label %columns
columns:
  %i = phi i64 [ 0, %entry ], [ %next, %done ]
  %more = icmp slt i64 %i, %wide
  br i1 %more, label %begin, label %end
begin:
  %xi = getelementptr double, ptr %x, i64 %i
  %yi = getelementptr double, ptr %y, i64 %i
  br label %sum
sum:
  %j = phi i64 [ 0, %begin ], [ %j1, %term ]
  %xj = phi ptr [ %xi, %begin ], [ %x1, %term ]
  %yj = phi ptr [ %yi, %begin ], [ %y1, %term ]
  %total = phi {vector} [ zeroinitializer, %begin ], [ %t1, %term ]
{weight}  %again = icmp slt i64 %j, %terms
  br i1 %again, label %term, label %done
term:
  {"%a0" if weighs else "%a"} = load {vector}, ptr %xj, align 8
  %b = load {vector}, ptr %yj, align 8
{weighed}  %ab = fmul contract {vector} %a, %b
  %t1 = fadd contract {vector} %total, %ab
  %j1 = add i64 %j, 1
  %x1 = getelementptr double, ptr %xj, i64 {step}
  %y1 = getelementptr double, ptr %yj, i64 {-step}
  br label %sum
done:
  %o = getelementptr double, ptr %out, i64 %i
  store {vector} %total, ptr %o, align 8
  %next = add i64 %i, {size}
  br label %columns
end:
  ret void
}}"""


def write_polynomials(module: Module, columns: int) -> None:
    """polynomials(series, values, slopes, rows, wide, x): of so many columns, side by side."""
    size = width(module.lanes)
    vector = f"<{size} x double>"
    module.functions["polynomials"] = f"""\
define void @polynomials(ptr %c, ptr %v, ptr %s, i64 %rows, i64 %wide, ptr %xs) nounwind {{
entry:
  %x = load {vector}, ptr %xs, align 8
  br label %columns
columns:
  %i = phi i64 [ 0, %entry ], [ %next, %done ]
  %more = icmp slt i64 %i, %wide
  br i1 %more, label %sum, label %end
sum:
  %m = phi i64 [ %rows, %columns ], [ %m1, %term ]
  %value = phi {vector} [ zeroinitializer, %columns ], [ %v1, %term ]
  %slope = phi {vector} [ zeroinitializer, %columns ], [ %s1, %term ]
  %again = icmp sgt i64 %m, 0
  br i1 %again, label %term, label %done
term:
  %m1 = sub i64 %m, 1
  %row = mul i64 %m1, {columns * module.lanes}
  %place = add i64 %row, %i
  %at = getelementptr double, ptr %c, i64 %place
  %one = load {vector}, ptr %at, align 8
  %sx = fmul contract {vector} %slope, %x
  %s1 = fadd contract {vector} %sx, %value
  %vx = fmul contract {vector} %value, %x
  %v1 = fadd contract {vector} %vx, %one
  br label %sum
done:
  %vo = getelementptr double, ptr %v, i64 %i
  store {vector} %value, ptr %vo, align 8
  %so = getelementptr double, ptr %s, i64 %i
  store {vector} %slope, ptr %so, align 8
  %next = add i64 %i, {size}
  br label %columns
end:
  ret void
}}"""
