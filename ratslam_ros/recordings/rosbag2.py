# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""rosbag2 folders and single files: which files there are, and what the metadata says of them."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from ratslam_ros.errors import UnusableInput
from ratslam_ros.recordings.bag import BagRecording
from ratslam_ros.recordings.files import Workspace, starts_with, storage_kind
from ratslam_ros.recordings.image_folder import natural
from ratslam_ros.recordings.mcap_file import McapFile
from ratslam_ros.recordings.rosbag1 import Rosbag1File
from ratslam_ros.recordings.sqlite_file import SqliteFile
from ratslam_ros.recordings.stream import Storage, Warnings

METADATA = 'metadata.yaml'
BAG_SUFFIXES = ('.mcap', '.db3', '.bag', '.mcap.zstd', '.db3.zstd')


@dataclass(slots=True)
class _Metadata:
    """What is used of metadata.yaml: the files, and the counts of messages."""

    files: list[str] = field(default_factory=list)
    file_counts: dict[str, int] = field(default_factory=dict)
    topic_counts: dict[str, int] | None = None
    message_count: int | None = None
    formats: dict[str, str] = field(default_factory=dict)


def bag_files(folder: Path) -> list[Path]:
    """Return the files in a folder that look like parts of a recording, in order."""
    return sorted(
        (path for path in folder.iterdir() if path.name.endswith(BAG_SUFFIXES) and path.is_file()),
        key=lambda path: natural(path.name),
    )


def open_bag(path: Path) -> BagRecording:
    """Open a rosbag2 folder, a folder of ROS 1 bags or a single file of either."""
    warnings, workspace = Warnings(), Workspace()
    storages: list[Storage] = []
    try:
        if path.is_dir():
            metadata = _read_metadata(path, warnings)
            files = _files_of(path, metadata, warnings)
        else:
            metadata, files = _metadata_beside(path), [path]
        empty = []
        for file in files:
            expected = metadata.file_counts.get(file.name)
            if expected is None and len(files) == 1:
                expected = metadata.message_count
            try:
                storages.append(_open_file(file, warnings, workspace, expected))
            except UnusableInput as error:
                if len(files) == 1:
                    raise
                empty.append(str(error))  # the other files of a split recording may be well
        if not storages:
            raise UnusableInput(empty[0])
        for text in empty:
            warnings.add(text)
        whole = not empty and len(storages) == len(metadata.files)
        return BagRecording(
            path,
            storages,
            warnings,
            workspace,
            metadata.topic_counts if whole else None,
            metadata.formats,
        )
    except BaseException:
        for storage in storages:
            storage.close()
        workspace.close()
        raise


def _open_file(
    path: Path, warnings: Warnings, workspace: Workspace, expected: int | None
) -> Storage:
    kind, plain = storage_kind(starts_with(path)), path
    if kind == 'zstd':
        plain, whole = workspace.decompressed(path)
        if not whole:
            warnings.add(
                f'{path.name} is truncated or damaged: it was decompressed as far as that goes'
            )
        if not plain.stat().st_size:
            raise UnusableInput(
                f'{path} is truncated or damaged and nothing in it can be read: expected a '
                'compressed recording; copy it again from where it was recorded'
            )
        kind = storage_kind(starts_with(plain))
    if kind == 'sqlite3':
        leftovers = [
            leftover
            for suffix in ('-wal', '-journal')
            if (leftover := Path(f'{path}{suffix}')).is_file() and leftover.stat().st_size
        ]
        if leftovers:
            # The recorder was killed: its last messages are only in the log, and SQLite would
            # write beside the recording to read them.
            plain = workspace.copied(path, leftovers)
            SqliteFile.merge_log(plain)
            warnings.add(
                f'{path.name} was not closed: its write-ahead log {leftovers[0].name} '
                'is read as well, in a temporary copy'
            )
        return SqliteFile(plain, warnings, expected)
    if kind == 'mcap':
        return McapFile(plain, warnings, expected)
    if kind == 'ros1':
        return Rosbag1File(plain, warnings, expected)
    raise UnusableInput(
        f'{path} begins with {starts_with(plain)[:13]!r}: expected an mcap, an SQLite or a ROS 1 '
        'bag file (format 2.0); copy it again from where it was recorded, or convert it'
    )


def _files_of(folder: Path, metadata: _Metadata, warnings: Warnings) -> list[Path]:
    """Return the files that the metadata list, or those there are where it lists none."""
    listed = [folder / Path(name).name for name in metadata.files]
    present = [path for path in listed if path.is_file()]
    if listed and not present:
        warnings.add(
            f'none of the files that {METADATA} lists is there: all files in the folder are read'
        )
    elif len(present) < len(listed):
        missing = [path.name for path in listed if path not in present]
        warnings.add(
            f'{len(missing)} of {len(listed)} files of the recording are missing: '
            f'{", ".join(missing[:5])}'
        )
    found = present or bag_files(folder)
    if not found:
        raise UnusableInput(
            f'{folder} holds a {METADATA} and no file with messages: expected '
            f'{", ".join(metadata.files[:3]) or "a .mcap or .db3 file"}; copy the whole folder'
        )
    return found


def _metadata_beside(path: Path) -> _Metadata:
    """Return what the folder's metadata say of a single file, if they say anything."""
    metadata = _read_metadata(path.parent, Warnings())
    names = [Path(name).name for name in metadata.files]
    if path.name not in names:
        return _Metadata()
    if len(names) > 1:
        return _Metadata(file_counts=metadata.file_counts, formats=metadata.formats)
    return metadata


def _read_metadata(folder: Path, warnings: Warnings) -> _Metadata:
    """Read metadata.yaml; what is missing in it, or all of it, stays unknown."""
    path = folder / METADATA
    if not path.is_file():
        return _Metadata()
    try:
        loader = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)
        about: Any = yaml.load(path.read_text(errors='replace'), loader)
        about = about['rosbag2_bagfile_information']
        return _Metadata(
            [str(name) for name in about['relative_file_paths']],
            {
                Path(file['path']).name: int(file['message_count'])
                for file in about.get('files') or []
            },
            {
                str(topic['topic_metadata']['name']): int(topic['message_count'])
                for topic in about['topics_with_message_count']
            },
            int(about['message_count']),
            {
                str(topic['topic_metadata']['name']): str(
                    topic['topic_metadata']['serialization_format']
                )
                for topic in about['topics_with_message_count']
            },
        )
    except (OSError, yaml.YAMLError, KeyError, TypeError, ValueError, AttributeError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        warnings.add(f'{path} is damaged ({reason}): the files in the folder are read without it')
        return _Metadata()
