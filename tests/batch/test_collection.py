"""What a collection is: folders, tables, and what of them is refused by name."""

from pathlib import Path

import pytest

from photoreg.batch.collection import COLUMNS, find_inputs, read_collection
from photoreg.batch.settings import ObjectSettings
from photoreg.errors import InputError
from photoreg.registration.config import RegistrationConfig
from tests.batch.collections import make_collection, make_object

ASKED = ObjectSettings(config=RegistrationConfig.preset("fast", seed=4))


def read(path: Path):
    return read_collection(path, ASKED)


def table(folder: Path, *lines: str) -> Path:
    path = folder / "objects.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def refused(path: Path) -> str:
    with pytest.raises(InputError) as error:
        read(path)
    return str(error.value)


def test_each_folder_is_an_object_with_what_its_suffixes_tell(tmp_path):
    make_collection(tmp_path, 2)
    (tmp_path / ".hidden").mkdir()
    (tmp_path / "notes.txt").write_text("not an object")
    first, second = read(tmp_path)
    assert (first.name, second.name) == ("object 0000", "object 0001")
    inputs = first.inputs()
    assert inputs.mesh.name == "rock.ply"
    assert inputs.cameras.name == "rough.json"
    assert [photo.suffix for photo in inputs.photos] == [".png", ".png"]
    assert set(first.files()) == {
        "rock.ply",
        "rough.json",
        *(path.name for path in first.base.iterdir()),
    }


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda f: (f / "rock.ply").unlink(), "There is no mesh in a"),
        (
            lambda f: (f / "b.stl").write_bytes(b"x"),
            "2 meshes in a: b.stl and rock.ply",
        ),
        (lambda f: [p.unlink() for p in f.glob("*.png")], "There are no photos in a"),
        (lambda f: (f / "rough.json").unlink(), "No cameras are among"),
    ],
)
def test_a_folder_that_is_not_clear_is_refused_by_name(tmp_path, change, said):
    folder = make_object(tmp_path / "a")
    change(folder)
    with pytest.raises(InputError, match=said):
        find_inputs(folder)


def test_a_row_names_files_and_settings(tmp_path):
    make_object(tmp_path / "a")
    (thing,) = read(
        table(
            tmp_path,
            "cameras,object,mesh,photos,preset,seed,lock_focal,share_focal,distortion",
            'a/rough.json,"Krug, groß",a/rock.ply,a/clean-left.png; a/clean-right.png,'
            "thorough,11,clean-left.png,all,none",
            "",
        )
    )
    assert thing.name == "Krug, groß"
    assert [p.name for p in thing.inputs().photos] == [
        "clean-left.png",
        "clean-right.png",
    ]
    settings = thing.settings
    thorough = RegistrationConfig.preset("thorough", seed=11)
    assert settings.config.genetic == thorough.genetic
    assert (settings.config.seed, settings.config.distortion) == (11, "none")
    assert settings.lock_focal == ("clean-left.png",)
    assert settings.share_focal == ((),)
    # Photos by folder; without settings those of the command.
    (thing,) = read(
        table(tmp_path, "object,mesh,photos,cameras", "a,a/rock.ply,a,a/rough.json")
    )
    assert len(thing.inputs().photos) == 2
    assert thing.settings == ASKED


ROW = "a,a/rock.ply,a,a/rough.json"


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (["object,mesh,photos"], "line 1: there is no column cameras"),
        (["object,mesh,photos,cameras,colour"], "line 1: .* but there is 'colour'"),
        (["object,mesh,photos,cameras,mesh"], "line 1: .* 'mesh' twice"),
        (["object;mesh;photos;cameras"], "separated by commas"),
        (["object,mesh,photos,cameras", ROW, "b,c"], "line 3: there are 2 cells for 4"),
        (
            ["object,mesh,photos,cameras", ROW, ROW.replace("a,", "A,", 1)],
            "line 3: A and a",
        ),
        (
            ["object,mesh,photos,cameras", ROW.replace("a,", "../a,", 1)],
            "line 2: '../a'",
        ),
        (["object,mesh,photos,cameras", ROW.replace("a,", "index.html,", 1)], "line 2"),
        (["object,mesh,photos,cameras", "a,,a,a/rough.json"], "the column mesh"),
        (["object,mesh,photos,cameras,seed", f"{ROW},x1"], "column seed: 'x1'"),
        (["object,mesh,photos,cameras,seed", f"{ROW},99999999999999999999"], "seed is"),
        (
            ["object,mesh,photos,cameras,preset", f"{ROW},best"],
            "preset: 'best' is not one of",
        ),
        (["object,mesh,photos,cameras,distortion", f"{ROW},k9"], "'k9' is not one of"),
        (["object,mesh,photos,cameras"], "There are no objects"),
    ],
)
def test_a_table_that_is_not_understood_is_refused_by_line_and_name(
    tmp_path, lines, said
):
    make_object(tmp_path / "a")
    with pytest.raises(InputError, match=said):
        read(table(tmp_path, *lines))


def test_a_table_in_another_encoding_is_refused(tmp_path):
    path = tmp_path / "objects.csv"
    path.write_bytes("object,mesh,photos,cameras\nGröße,a,b,c\n".encode("latin-1"))
    assert "UTF-8" in refused(path)


def test_a_missing_file_of_a_row_is_the_object_s_problem_only(tmp_path):
    make_object(tmp_path / "a")
    rows = (ROW, "b,b/rock.ply,a,a/rough.json")
    first, second = read(table(tmp_path, "object,mesh,photos,cameras", *rows))
    first.inputs()
    with pytest.raises(InputError, match=r"b/rock.ply does not exist"):
        second.inputs()


def test_one_object_s_own_folder_is_not_taken_for_a_collection(tmp_path):
    assert "Give the folder" in refused(make_object(tmp_path / "a"))
    assert "does not exist" in refused(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    assert "no objects" in refused(tmp_path / "empty")


def test_the_documentation_names_every_column():
    page = (Path(__file__).parents[2] / "docs" / "batch" / "one-machine.md").read_text()
    for column in COLUMNS:
        assert f"`{column}`" in page, column
