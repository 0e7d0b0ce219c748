"""The right to read a file, asked by root for the service's own user, which may not enter root's folders."""

from __future__ import annotations

import os
import pwd
import stat
from dataclasses import dataclass
from pathlib import Path

SERVICE_USER = "pointclick"  # of systemd/pointclick-onboard.service


@dataclass(frozen=True)
class Reader:
    """A user and the groups that it is in; `name` is empty for who runs this program."""

    name: str
    uid: int
    groups: frozenset[int]

    @classmethod
    def of_the_service(cls) -> Reader:
        """The service's user, if root asks and there is one; else who runs this program."""
        if os.geteuid() == 0:
            try:
                entry = pwd.getpwnam(SERVICE_USER)
            except KeyError:
                pass
            else:
                return cls(entry.pw_name, entry.pw_uid, frozenset(os.getgrouplist(entry.pw_name, entry.pw_gid)))
        return cls("", os.geteuid(), frozenset({os.getegid(), *os.getgroups()}))

    def complaint(self, path: Path) -> str:
        """Return why this user cannot read a file, and what to do; empty if it can."""
        try:
            for folder in reversed(path.absolute().parents):
                if not self._may(folder.stat(), stat.S_IXOTH):
                    return f"{self._who} may not enter {folder}: {self._mend(folder, 'rx')}"
            if not self._may(path.stat(), stat.S_IROTH):
                return f"{self._who} may not read it: {self._mend(path, 'r')}"
        except OSError as error:
            return error.strerror or str(error)
        return ""

    @property
    def _who(self) -> str:
        return f"the service's user {self.name}" if self.name else "this user"

    def _mend(self, path: Path, right: str) -> str:
        return f"chgrp {self.name or SERVICE_USER} {path} && chmod g+{right} {path}"

    def _may(self, status: os.stat_result, bit: int) -> bool:
        if self.uid == 0:
            return True
        if status.st_uid == self.uid:
            return bool(status.st_mode & bit << 6)
        return bool(status.st_mode & (bit << 3 if status.st_gid in self.groups else bit))
