"""Cases of a campaign: configurations checked by their kind, each with a key.

The key is the SHA-256 of the version of the code and the full configuration, including defaults.
Files enter with their contents instead of their paths. Equal keys mean equal results.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec

from firmware_py.core.errors import InputError
from hil.campaign.case_task import CaseTask, canonical_json
from hil.campaign.code_version import code_version, content_sha256
from hil.campaign.kinds.case_kind import CaseKind, kind_module

KEY_DIGITS: Final = 32
"""Hexadecimal digits of a key: 128 bits."""


@dataclass(frozen=True)
class CampaignCase:
    """One case of a campaign."""

    key: str  # Hash that names its result
    config: Any  # Configuration with the paths as in the campaign's file


class CaseMaker:
    """Maker of the cases and tasks of one kind.

    `directory` holds files that cases share, such as a twin that was built for them.
    """

    def __init__(self, kind: CaseKind[Any], module: str, directory: Path) -> None:
        self.kind, self.module = kind, kind_module(module)
        self.code = code_version(kind.rooms)
        self._directory = directory
        self._hashes: dict[str, str] = {}

    def cases(self, configurations: Iterable[Mapping[str, Any]], where: str) -> list[CampaignCase]:
        """Return the cases of some configurations, without duplicates."""
        found: dict[str, CampaignCase] = {}
        for number, plain in enumerate(configurations, start=1):
            try:
                config = msgspec.convert(plain, self.kind.config)
                self.kind.check(config)
            except msgspec.ValidationError as error:
                raise InputError(
                    where, f"makes case {number} of kind {self.kind.name}, which does not fit: "
                    f"{error}", "see docs/campaigns.md for the keys of each kind",
                ) from None  # fmt: skip
            case = CampaignCase(self._key(config), config)
            found.setdefault(case.key, case)
        return list(found.values())

    def task(self, case: CampaignCase) -> CaseTask:
        """Return a case's task for a worker, with absolute paths; shared files are made first."""
        shared = self.kind.prepare(case.config, self._directory)
        config = msgspec.structs.replace(case.config, **shared)
        paths = {name: str(Path(p).resolve()) for name, p in self.kind.files(config).items()}
        plain = msgspec.to_builtins(msgspec.structs.replace(config, **paths))
        return CaseTask(
            key=case.key, kind=self.module, config=canonical_json(plain), code=self.code,
            files={path: self._hash(path) for path in paths.values()},
        )  # fmt: skip

    def _key(self, config: Any) -> str:
        files = {name: self._hash(path) for name, path in self.kind.files(config).items()}
        body = {
            "kind": self.kind.name, "code": self.code,
            "config": msgspec.to_builtins(config) | files,
        }  # fmt: skip
        return hashlib.sha256(canonical_json(body).encode()).hexdigest()[:KEY_DIGITS]

    def _hash(self, path: str) -> str:
        if path not in self._hashes:
            self._hashes[path] = content_sha256(Path(path))
        return self._hashes[path]
