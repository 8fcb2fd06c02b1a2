"""Settings in a file: nothing is lost, nothing is guessed, and errors say where."""

import json

import pytest
from hypothesis import given
from hypothesis import settings as effort
from hypothesis import strategies as st

import napari_defocus
from napari_defocus import Settings
from napari_defocus.io.settings_file import said_in
from napari_defocus.settings import MapSettings, MaskSettings, RefocusSettings, RestorationSettings

UNUSUAL = Settings(
    map=MapSettings(
        noise_variance=3.3e-5,
        psf="polygon:6:12.5",
        max_radius=6.1,
        window=51,
        stride=3,
        smoothness=7.0,
        color_sigma=0.2,
        mode="paper",
        linearize="srgb",
    ),
    mask=MaskSettings(threshold=1.3, smoothness=500.0, color_sigma=0.07),
    restoration=RestorationSettings(noise_variance=1e-6, tv_weight=0.1 + 0.2, risk=0.25),
    refocus=RefocusSettings(focus=-1.5, aperture=2.0, side="near", linearize=None),
)


@pytest.fixture
def file(tmp_path):
    return tmp_path / "settings.json"


def written(file, content):
    file.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
    return file


@pytest.mark.parametrize("settings", [Settings(), UNUSUAL], ids=["defaults", "unusual"])
def test_what_was_saved_is_loaded(file, settings):
    settings.save(file)
    assert Settings.load(file) == settings


@effort(deadline=None, max_examples=30)
@given(
    noise_variance=st.none() | st.floats(0, 1),
    max_radius=st.floats(1, 20),
    smoothness=st.floats(0, 1e15),
    shot_noise=st.booleans(),
    threshold=st.floats(0, 1e6),
)
def test_no_digit_is_lost(tmp_path_factory, max_radius, smoothness, shot_noise, **more):
    variance = None if shot_noise else more["noise_variance"]
    estimation = MapSettings(
        noise_variance=variance,
        shot_noise=shot_noise,
        max_radius=max_radius,
        smoothness=smoothness,
    )
    settings = Settings(map=estimation, mask=MaskSettings(threshold=more["threshold"]))
    file = tmp_path_factory.mktemp("settings") / "settings.json"
    settings.save(file)
    assert Settings.load(file) == settings


def test_file_can_be_read_by_people_and_says_what_wrote_it(file):
    Settings(map=MapSettings(psf="Objektiv für grün.npz")).save(file)
    lines = file.read_text(encoding="utf-8").splitlines()
    assert f'  "napari_defocus": "{napari_defocus.__version__}",' in lines
    assert '    "psf": "Objektiv für grün.npz",' in lines
    assert list(json.loads("\n".join(lines))) == [
        "napari_defocus",
        "unit",
        "map",
        "mask",
        "restoration",
        "refocus",
    ]


def test_file_that_exists_is_overwritten_only_if_asked(file):
    Settings().save(file)
    before = file.read_bytes()
    with pytest.raises(OSError, match="exists already"):
        UNUSUAL.save(file)
    assert file.read_bytes() == before
    UNUSUAL.save(file, force=True)
    assert Settings.load(file) == UNUSUAL
    assert [path.name for path in file.parent.iterdir()] == ["settings.json"]


def test_what_is_missing_has_its_default(file):
    assert Settings.load(written(file, {})) == Settings()
    written(file, {"mask": {"threshold": 3}, "refocus": {}})
    assert Settings.load(file) == Settings(mask=MaskSettings(threshold=3.0))
    assert said_in(file) == {"mask": {"threshold": 3.0}, "refocus": {}}


def test_whole_numbers_and_the_marks_of_editors_are_read(file):
    file.write_bytes(b'\xef\xbb\xbf{"map": {"max_radius": 6, "window": 51}}')
    loaded = Settings.load(file).map
    assert loaded == MapSettings(max_radius=6.0, window=51)
    assert isinstance(loaded.max_radius, float)
    assert isinstance(loaded.window, int)


def test_lens_is_looked_for_when_it_is_used(file):
    written(file, {"map": {"psf": "not here.npz"}})
    assert Settings.load(file).map.psf == "not here.npz"
    with pytest.raises(ValueError, match="no such file"):
        Settings.load(file).map.family()


def test_px_of_a_lens_that_had_another_unit_once_are_not_read_as_radii(file):
    early = {"napari_defocus": "0.1.0", "map": {"psf": "gaussian"}, "mask": {"threshold": 1.0}}
    written(file, early)
    with pytest.raises(ValueError, match=r'early unit of .* "gaussian"; .* add "unit": "blur'):
        Settings.load(file)
    written(file, early | {"unit": "blur radius (px)"})
    assert Settings.load(file).mask.threshold == 1.0
    written(file, early | {"map": {"psf": "disc"}})
    assert Settings.load(file).mask.threshold == 1.0, "those of discs have always been radii"


@pytest.mark.parametrize(
    ("content", "saying"),
    [
        ("", "it is not JSON"),
        ("{'map': {}}", "it is not JSON"),
        ("[" * 100_000, "nested too deeply"),
        ("[1, 2]", r"it is \[1, 2\]; it takes an object"),
        ({"map": None}, '"map" is null; it takes an object'),
        ({"maps": {}}, 'the part "maps"; it takes map, mask, restoration, refocus'),
        ({"napari_defocus": 1}, '"napari_defocus" is 1; it takes a text'),
        ({"mask": {"treshold": 2}}, '"treshold"; it takes threshold, smoothness, color_sigma'),
        ({"mask": {"threshold": "2"}}, '"threshold" of "mask" is "2"; it takes a number'),
        ({"mask": {"threshold": True}}, "is true; it takes a number"),
        ({"mask": {"threshold": None}}, "is null; it takes a number"),
        ({"map": {"noise_variance": []}}, r"is \[\]; it takes a number or null"),
        ({"map": {"shot_noise": 1}}, "is 1; it takes true or false"),
        ({"map": {"window": 41.0}}, "is 41.0; it takes a whole number"),
        ({"map": {"linearize": "SRGB"}}, '"linearize" .* "SRGB"; it takes "srgb" or null'),
        ({"map": {"mode": "thesis"}}, '"mode" .* "thesis"; it takes "curve" or "paper"'),
        ({"map": {"smoothness": -1}}, 'in "map", smoothness is -1.0; it takes a finite number'),
        ({"map": {"smoothness": 10**400}}, 'in "map", '),
        ('{"map": {"smoothness": 1e999}}', "smoothness is inf"),
        ('{"map": {"smoothness": NaN}}', "the value NaN; it takes finite numbers"),
        ({"map": {"psf": "square"}}, "psf is 'square'; it takes disc"),
        ({"map": {"max_radius": -2}}, 'in "map", max_radius is -2'),
        ({"map": {"psf": "lens.npz", "max_radius": 0.5}}, "max_radius is 0.5"),
        ({"map": {"window": 42}}, "window is 42; it takes an odd number"),
        ({"map": {"stride": 0}}, "stride is 0; it takes a whole number"),
        ({"map": {"noise_variance": 1e-5, "shot_noise": True}}, "shot_noise is set"),
        ({"refocus": {"aperture": -1}}, 'in "refocus", aperture is -1'),
        ({"restoration": {"risk": 2}}, 'in "restoration", risk is 2.0; it takes a number from 0'),
    ],
)
def test_what_cannot_be_is_refused_with_the_file_and_the_key(file, content, saying):
    with pytest.raises(ValueError, match=saying) as refusal:
        Settings.load(written(file, content))
    assert str(refusal.value).startswith(f"cannot read {file}: ")


def test_text_that_is_no_utf_8_is_refused(file):
    file.write_bytes(b'{"map": {"psf": "gr\xfcn"}}')
    with pytest.raises(ValueError, match=r"settings\.json: it is not JSON, which is UTF-8"):
        Settings.load(file)


def test_files_that_are_not_there_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.json: there is no such file"):
        Settings.load(tmp_path / "none.json")
    with pytest.raises(ValueError, match="it is a folder"):
        Settings.load(tmp_path)
