"""docs/licences.md says of every package that is installed what its metadata says."""

import pytest

from tests import licences

LISTED = dict(licences.listed(licences.PAGE.read_text()))


@pytest.mark.parametrize("package", licences.installed())
def test_every_dependency_is_listed_with_the_kind_of_its_licence(package: str) -> None:
    kind = licences.kind(licences.licence(package))
    assert kind != "unknown"
    assert LISTED.get(package) == kind, "run `make licences`"


def test_no_package_is_listed_that_nothing_asks_for() -> None:
    gone = set(LISTED) - set(licences.installed())
    assert not gone, "run `make licences`"
    assert len(LISTED) > 30


@pytest.mark.parametrize(
    ("said", "kind"),
    [
        ("GPL-3.0-or-later", "copyleft"),
        ("GNU GPLv3", "copyleft"),
        ("AGPL-3.0-only", "copyleft"),
        ("LGPL-2.1", "weak copyleft"),
        ("MPL-2.0 AND MIT", "weak copyleft"),
        ("MIT-CMU", "permissive"),
        ("not said", "unknown"),
    ],
)
def test_what_a_licence_asks_is_read_from_its_name(said: str, kind: str) -> None:
    assert licences.kind(said) == kind
