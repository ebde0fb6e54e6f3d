# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sums of absolute differences of bytes, as the one machine instruction that they are.

LLVM knows the pattern below on every processor (psadbw, uabdl and their like); left to itself it
widens each byte to 32 bits first, which is several times slower. Integers: the result is exact.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

LANES = 32
"""Bytes that are compared at once."""


@intrinsic
def sad_of_lanes(typing: Any, a: Any, at_a: Any, b: Any, at_b: Any) -> Any:
    """Return the sum of |a[at_a + k] - b[at_b + k]| for k below LANES, int64.

    ``a`` and ``b``: contiguous (n,) uint8. Nothing checks the bounds.
    """
    signature = types.int64(a, types.intp, b, types.intp)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        bytes_type = ir.VectorType(ir.IntType(8), LANES)
        wide_type = ir.VectorType(ir.IntType(32), LANES)
        zero = ir.Constant(wide_type, [0] * LANES)

        def load(kind: Any, array: Any, index: Any) -> Any:
            data = context.make_array(kind)(context, builder, array).data
            pointer = builder.bitcast(builder.gep(data, [index]), bytes_type.as_pointer())
            loaded = builder.load(pointer)
            loaded.align = 1
            return builder.zext(loaded, wide_type)

        first = load(signature.args[0], arguments[0], arguments[1])
        second = load(signature.args[2], arguments[2], arguments[3])
        difference = builder.sub(first, second)
        is_negative = builder.icmp_signed('<', difference, zero)
        absolute = builder.select(is_negative, builder.sub(zero, difference), difference)
        add_up = cgutils.get_or_insert_function(
            builder.module,
            ir.FunctionType(ir.IntType(32), [wide_type]),
            f'llvm.vector.reduce.add.v{LANES}i32',
        )
        return builder.zext(builder.call(add_up, [absolute]), ir.IntType(64))

    return signature, generate
