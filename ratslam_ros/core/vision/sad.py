# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sum of absolute differences (SAD) of byte arrays, compiled to SIMD instructions.

On x86, the psadbw instruction is emitted for the widest available registers. On other processors,
LLVM is given a pattern that it compiles to the matching instruction (such as uabdl on ARM). Plain
numba code would widen each byte to 32 bits first, which is several times slower. The sums are
integers, so the result is exact.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.typing import NDArray

PIECE_BYTES = 64
"""Bytes compared at once. Compared arrays must be readable up to a multiple of this."""

UNROLLED_PIECES = 10
"""Up to this number of pieces, the loop over the pieces is unrolled."""

_PSADBW = {
    64: 'llvm.x86.avx512.psad.bw.512',
    32: 'llvm.x86.avx2.psad.bw',
    16: 'llvm.x86.sse2.psad.bw',
}
"""LLVM intrinsic by register width in bytes."""

_PATTERN_BYTES = 32
"""Vector width of the generic pattern for other processors."""


def pieces_of(length: int) -> tuple[int, NDArray[np.uint8]]:
    """Return the number of pieces for ``length`` bytes, and the mask of the last piece.

    The mask is (PIECE_BYTES,) uint8, 255 for used bytes and 0 for others.
    """
    pieces = max(-(-length // PIECE_BYTES), 1)
    inside = np.arange(PIECE_BYTES) < length - (pieces - 1) * PIECE_BYTES
    return pieces, inside.astype(np.uint8) * np.uint8(255)


def _register_bytes(context: Any) -> int:
    """Return the widest register for psadbw on the target processor, in bytes; 0: none."""
    triple, _, features = context.codegen().magic_tuple()
    if not triple.startswith('x86_64'):
        return 0
    available = features.split(',')
    return 64 if '+avx512bw' in available else 32 if '+avx2' in available else 16


def sad_by(width_bytes: int | None) -> Any:
    """Return a ``sad`` function for a register width.

    Args:
        width_bytes: register width; 0: the generic LLVM pattern; None: the widest register of the
            processor.
    """

    @intrinsic
    def sad_of(
        typing: Any, a: Any, at_a: Any, b: Any, at_b: Any, pieces: Any, inside: Any
    ) -> Any:
        signature = types.int64(a, types.intp, b, types.intp, types.intp, inside)

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            width = _register_bytes(context) if width_bytes is None else width_bytes
            step, total_type, difference = _difference(builder, width)
            bytes_type = ir.VectorType(ir.IntType(8), step)

            def pointer(array: int, index: Any) -> Any:
                kind = signature.args[array]
                data = context.make_array(kind)(context, builder, arguments[array]).data
                return builder.gep(data, [index])

            def load(base: Any, offset: Any) -> Any:
                at = builder.bitcast(builder.gep(base, [offset]), bytes_type.as_pointer())
                loaded = builder.load(at)
                loaded.align = 1
                return loaded

            first = pointer(0, arguments[1])
            second = pointer(2, arguments[3])
            mask = pointer(5, ir.IntType(64)(0))
            total = cgutils.alloca_once_value(builder, ir.Constant(total_type, None))

            def add_piece(at: Any, masked: bool) -> None:
                for part in range(0, PIECE_BYTES, step):
                    offset = builder.add(at, at.type(part))
                    x, y = load(first, offset), load(second, offset)
                    if masked:
                        bits = load(mask, at.type(part))
                        x, y = builder.and_(x, bits), builder.and_(y, bits)
                    builder.store(builder.add(builder.load(total), difference(x, y)), total)

            # Unrolled for each usual number of pieces, as the overhead of so short a loop would be
            # as large as its work.
            count = arguments[4]
            done = builder.append_basic_block('sad.done')
            many = builder.append_basic_block('sad.many')
            switch = builder.switch(count, many)
            for pieces in range(1, UNROLLED_PIECES + 1):
                block = builder.append_basic_block(f'sad.{pieces}')
                switch.add_case(count.type(pieces), block)
                with builder.goto_block(block):
                    for number in range(pieces):
                        add_piece(count.type(number * PIECE_BYTES), masked=number == pieces - 1)
                    builder.branch(done)
            builder.position_at_end(many)
            last = builder.sub(count, count.type(1))
            with cgutils.for_range(builder, last) as loop:
                add_piece(builder.mul(loop.index, count.type(PIECE_BYTES)), masked=False)
            add_piece(builder.mul(last, count.type(PIECE_BYTES)), masked=True)
            builder.branch(done)
            builder.position_at_end(done)
            return _sum_of_lanes(builder, builder.load(total))

        return signature, generate

    return sad_of


def _difference(builder: Any, width: int) -> tuple[int, Any, Any]:
    """Return vector width in bytes, type of the SAD, and the function that emits the SAD."""
    if width:
        bytes_type = ir.VectorType(ir.IntType(8), width)
        lanes_type = ir.VectorType(ir.IntType(64), width // 8)
        psadbw = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(lanes_type, [bytes_type] * 2), _PSADBW[width]
        )
        return width, lanes_type, lambda x, y: builder.call(psadbw, [x, y])
    wide_type = ir.VectorType(ir.IntType(32), _PATTERN_BYTES)
    zero = ir.Constant(wide_type, None)

    def by_pattern(x: Any, y: Any) -> Any:
        d = builder.sub(builder.zext(x, wide_type), builder.zext(y, wide_type))
        absolute = builder.select(
            builder.icmp_signed('<', d, zero), builder.sub(zero, d), d
        )
        return builder.zext(_sum_of_lanes(builder, absolute), ir.IntType(64))

    return _PATTERN_BYTES, ir.IntType(64), by_pattern


def _sum_of_lanes(builder: Any, vector: Any) -> Any:
    if not isinstance(vector.type, ir.VectorType):
        return vector
    kind = vector.type
    add_up = cgutils.get_or_insert_function(
        builder.module,
        ir.FunctionType(kind.element, [kind]),
        f'llvm.vector.reduce.add.v{kind.count}{kind.element}',
    )
    return builder.call(add_up, [vector])


sad = sad_by(None)
"""``sad(a, at_a, b, at_b, pieces, inside)``: the sum of |a[at_a + k] - b[at_b + k]|, int64.

Args:
    a, b: contiguous (n,) uint8, readable up to whole pieces.
    at_a, at_b: index of the first byte to compare.
    pieces, inside: result of ``pieces_of`` for the number of bytes to compare.

Array bounds are not checked.
"""
