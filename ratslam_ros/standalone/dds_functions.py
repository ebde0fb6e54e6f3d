# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Functions of Cyclone DDS's C library, called through ctypes.

Whatever may block goes through ctypes, which releases the interpreter's lock.
"""

from __future__ import annotations

import ctypes as ct
from collections.abc import Callable
from typing import Any

from cyclonedds.core import DDSException
from cyclonedds.internal import DDS, dds_c_t

from ratslam_ros.standalone.exceptions import RCLError

STATUSES = {
    'sample_lost': (1 << 5, dds_c_t.sample_lost_status),
    'requested_incompatible_qos': (1 << 4, dds_c_t.requested_incompatible_qos_status),
    'subscription_matched': (1 << 12, dds_c_t.subscription_matched_status),
    'offered_incompatible_qos': (1 << 3, dds_c_t.offered_incompatible_qos_status),
    'publication_matched': (1 << 11, dds_c_t.publication_matched_status),
}
"""What may happen to an endpoint: bit in masks, and what is told of it."""


class Sample(ct.Structure):
    """What the library's own topics take as a sample: serialised bytes."""

    _fields_ = (('data', ct.c_void_p), ('size', ct.c_size_t))


class Bytes(ct.Structure):
    """A piece of memory."""

    _fields_ = (('data', ct.c_void_p), ('size', ct.c_size_t))


def _plain_c(name: str, result: Any, *arguments: Any) -> Callable[..., Any]:
    """Return a C function whose prototype is ours alone."""
    made: Callable[..., Any] = ct.CFUNCTYPE(result, *arguments)((name, DDS._dll_handle))
    return made


def _c(name: str, *arguments: Any) -> Callable[..., int]:
    """Return a C function that raises where it returns an error."""
    function = _plain_c(name, ct.c_int32, *arguments)

    def call(*values: Any) -> int:
        result = function(*values)
        if result < 0:
            raise RCLError(f'{name}: {DDSException(result)}')
        return int(result)

    return call


def done(name: str, result: int) -> bool:
    """Return False where C says that the time was over; another error raises."""
    if result < 0 and result != DDSException.DDS_RETCODE_TIMEOUT:
        raise RCLError(f'{name}: {DDSException(result)}')
    return result >= 0


_entity = ct.c_int32
delete = _c('dds_delete', _entity)
write = _plain_c('dds_write', ct.c_int32, _entity, ct.c_void_p)
wait_for_acks = _plain_c('dds_wait_for_acks', ct.c_int32, _entity, ct.c_int64)
take = _c('dds_takecdr', _entity, ct.c_void_p, ct.c_uint32, ct.c_void_p, ct.c_uint32)
# A sample as the reader holds it: its bytes can be looked at with no copy, until it is let go.
sample_size = _plain_c('ddsi_serdata_size', ct.c_uint32, ct.c_void_p)
sample_bytes = _plain_c(
    'ddsi_serdata_to_ser_ref', ct.c_void_p, ct.c_void_p, ct.c_size_t, ct.c_size_t, ct.c_void_p
)
release_bytes = _plain_c('ddsi_serdata_to_ser_unref', None, ct.c_void_p, ct.c_void_p)
release_sample = _plain_c('ddsi_serdata_unref', None, ct.c_void_p)
create_reader = _c('dds_create_reader', _entity, _entity, ct.c_void_p, ct.c_void_p)
create_writer = _c('dds_create_writer', _entity, _entity, ct.c_void_p, ct.c_void_p)
create_condition = _c('dds_create_readcondition', _entity, ct.c_uint32)
create_guard = _c('dds_create_guardcondition', _entity)
set_guard = _c('dds_set_guardcondition', _entity, ct.c_bool)
take_guard = _c('dds_take_guardcondition', _entity, ct.c_void_p)
create_waitset = _c('dds_create_waitset', _entity)
attach = _c('dds_waitset_attach', _entity, _entity, ct.c_ssize_t)
detach = _c('dds_waitset_detach', _entity, _entity)
wait = _c('dds_waitset_wait', _entity, ct.c_void_p, ct.c_size_t, ct.c_int64)
set_mask = _c('dds_set_status_mask', _entity, ct.c_uint32)
get_handle = _c('dds_get_instance_handle', _entity, ct.c_void_p)
get_guid = _c('dds_get_guid', _entity, ct.c_void_p)
matched_readers = _c('dds_get_matched_subscriptions', _entity, ct.c_void_p, ct.c_size_t)
matched_writers = _c('dds_get_matched_publications', _entity, ct.c_void_p, ct.c_size_t)
get_status = {name: _c(f'dds_get_{name}_status', _entity, ct.c_void_p) for name in STATUSES}
