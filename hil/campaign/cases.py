"""Cases of a campaign: options checked by their kind, each case with a key.

The key is the SHA-256 of the version of the code and all options, including defaults. Files enter
with their contents instead of their paths. Equal keys mean equal results.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec

from firmware_py.core.errors import InputError
from firmware_py.core.input_files import resolved
from hil.campaign.code_version import code_version, content_sha256
from hil.campaign.kinds.case_kind import CaseKind, CaseOptions
from hil.campaign.worker import CaseTask

KEY_DIGITS: Final = 32
"""Hexadecimal digits of a key: 128 bits."""


@dataclass(frozen=True)
class CampaignCase:
    """One case of a campaign."""

    key: str  # Hash that names its result
    options: CaseOptions  # With the paths as in the campaign's file


class CaseMaker:
    """Maker of the cases and tasks of one kind.

    `directory` is for files that cases share, such as a twin that is built for them.
    """

    def __init__(self, kind: CaseKind[Any], module: str, directory: Path) -> None:
        self.kind, self.code = kind, code_version(kind.sources)
        self._module, self._directory = module, directory

    def cases(self, configurations: Iterable[Mapping[str, Any]], where: str) -> list[CampaignCase]:
        """Return the cases of some configurations, without duplicates."""
        cases: dict[str, CampaignCase] = {}
        for number, values in enumerate(configurations, start=1):
            try:
                _check_finite(values)
                options = msgspec.convert(values, self.kind.options)
            except ValueError as error:  # msgspec's error is one
                raise InputError(
                    where, f"makes case {number} of kind {self.kind.name}, which does not fit: "
                    f"{error}", "see docs/campaigns.md for the keys of each kind",
                ) from None  # fmt: skip
            key = self._key(options)
            cases.setdefault(key, CampaignCase(key, options))
        return list(cases.values())

    def task(self, case: CampaignCase) -> CaseTask:
        """Return a case's task for a worker, with absolute paths; shared files are made first."""
        options = self.kind.prepare(case.options, self._directory)
        paths = {name: str(resolved(Path(p))) for name, p in options.files().items()}
        return CaseTask(
            key=case.key, kind=self._module, code=self.code,
            options=msgspec.json.encode(msgspec.structs.replace(options, **paths)),
            files={path: content_sha256(Path(path)) for path in paths.values()},
        )  # fmt: skip

    def _key(self, options: CaseOptions) -> str:
        files = {name: content_sha256(Path(path)) for name, path in options.files().items()}
        values = msgspec.to_builtins(options) | files
        body = {"kind": self.kind.name, "code": self.code, "config": values}
        return hashlib.sha256(canonical_json(body).encode()).hexdigest()[:KEY_DIGITS]


def canonical_json(value: Any) -> str:
    """Encode as JSON with sorted keys and without spaces; NaN and infinity become null."""
    plain = msgspec.json.decode(msgspec.json.encode(value))  # msgspec writes NaN as null
    return json.dumps(plain, sort_keys=True, separators=(",", ":"), ensure_ascii=False)


def flat(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Flatten nested tables and lists of tables to values by dotted name."""
    values: dict[str, Any] = {}
    for name, value in table.items():
        if isinstance(value, dict):
            values |= flat(value, f"{prefix}{name}.")
        elif isinstance(value, list) and value and all(isinstance(v, dict) for v in value):
            values |= flat({str(k): v for k, v in enumerate(value)}, f"{prefix}{name}.")
        else:
            values[prefix + name] = value
    return values


def _check_finite(values: Mapping[str, Any]) -> None:
    for name, value in flat(values).items():
        if isinstance(value, float) and not math.isfinite(value):
            raise ValueError(f"{name} is {value}, which is not finite")
