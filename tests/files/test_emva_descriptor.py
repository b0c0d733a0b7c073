"""EMVA 1288 descriptor files as campaigns: backslashes and all, photon numbers kept, nothing opened outside the folder."""

from dataclasses import replace
from pathlib import Path

import imageio.v3
import numpy as np
import pytest

import isetval
from isetval import Exposure, InputError
from isetval.camera.chain import ShotSetup, mean_electrons
from isetval.camera.model import CameraModel
from isetval.core.captures import MemoryCaptures
from isetval.effects.color import QuantumEfficiency
from isetval.effects.converter import ConversionGain
from isetval.effects.optics_blur import Aperture
from isetval.files.campaign_writer import write_campaign
from isetval.files.emva_descriptor import load_emva_descriptor
from isetval.files.emva_lines import find_emva_descriptor

REAL = Path(__file__).parents[3] / "shared" / "data" / "real" / "emva1288_set001"
GAIN, QE, BLACK_DN, READ_DN = 0.25, 0.5, 20.0, 2.0
TIMES_NS = (40_000, 300_000, 600_000, 900_000, 1_200_000, 1_500_000, 1_800_000, 2_100_000)


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """Eight exposure times of two frames, bright and dark, and two stacks, as the working group lays them out."""
    folder = tmp_path_factory.mktemp("lab") / "set"
    (folder / "images").mkdir(parents=True)
    rng = np.random.default_rng(12)
    lines = ["# a remark", "v 3.0", "n 12 96 80"]

    def series(letter, time_ns, photons, frames, name):
        lines.append(f"{letter} {time_ns:.1f}" + (f" {photons:.1f}" if letter == "b" else ""))
        for i in range(frames):
            mean_e = QE * photons if letter == "b" else 0.0
            dn = BLACK_DN + GAIN * rng.poisson(mean_e, (80, 96)) + READ_DN * rng.standard_normal((80, 96))
            file = f"{name}_{i}.png"
            imageio.v3.imwrite(folder / "images" / file, np.clip(np.round(dn), 0, 4095).astype(np.uint16))
            lines.append(f"i images\\{file}")

    for k, time_ns in enumerate(TIMES_NS):
        series("b", time_ns, 0.01 * time_ns, 2, f"b_{k}")
    series("b", TIMES_NS[4], 0.01 * TIMES_NS[4], 9, "b_s")
    for k, time_ns in enumerate(TIMES_NS):
        series("d", time_ns, 0, 2, f"d_{k}")
    series("d", TIMES_NS[4], 0, 9, "d_s")
    (folder / "EMVA1288_Data.txt").write_bytes("\r\n".join(lines).encode() + b"\r\n")
    return folder


def test_series_become_shots(lab):
    campaign = isetval.load_campaign(lab)
    assert campaign.name == "set"
    assert [shot.name for shot in campaign.shots[7:10]] == ["flat_007", "flat_stack_000", "dark_000"]
    assert [len([s for s in campaign.shots if s.role == role]) for role in ("flat", "dark")] == [9, 9]
    assert [shot.photons_per_pixel for shot in campaign.shots[:8]] == pytest.approx([0.01 * t for t in TIMES_NS])
    assert [shot.exposure.time_s for shot in campaign.shots[:8]] == pytest.approx([t * 1e-9 for t in TIMES_NS])
    assert {shot.measurement_session for shot in campaign.shots if "stack" in shot.name} == {"B"}
    sensor = campaign.sensor
    assert (sensor.rows, sensor.cols, sensor.cfa, sensor.bits, sensor.white_dn) == (80, 96, "MONO", 12, 4095)
    # two frames of the shortest dark; 5 standard errors of the mean of 2 x 80 x 96 pixels
    assert sensor.black_dn[0][0] == pytest.approx(BLACK_DN, abs=5 * np.sqrt((READ_DN**2 + 1 / 12) / (2 * 80 * 96)))
    assert "mean of 2 dark frames of the shortest exposure (dark_000)" in campaign.notes[0]
    (first, second) = campaign.captures["flat_002"]
    np.testing.assert_array_equal(first.mosaic, imageio.v3.imread(lab / "images" / "b_2_0.png"))
    assert (second.exposure, second.sensor) == (Exposure(6e-4), sensor)


def test_planted_gain_and_quantum_efficiency_come_back(lab):
    """The measuring side takes the stated photon numbers; 5 sigma of its own error bars."""
    table = isetval.measure_campaign(isetval.load_campaign(lab))
    found = {m.name: m for m in table.metrics if m.summary and m.measurement_session == "A"}
    for name, truth in (("gain_dn_per_e", GAIN), ("quantum_efficiency", 100 * QE)):
        assert abs(found[name].value - truth) < 5 * found[name].sigma
        assert found[name].sigma < 0.05 * truth


def test_the_light_gives_the_stated_photons(lab, tmp_path):
    """Aperture f/8 and a quantum efficiency of one half: half the stated photons become electrons."""
    (tmp_path / "qe.csv").write_text("wavelength_nm,qe\n400,0.5\n700,0.5\n")
    for pixel_um in (1.0, 5.5):
        campaign = load_emva_descriptor(lab / "EMVA1288_Data.txt", pixel_um=pixel_um)
        effects = (Aperture(f_number=8.0), QuantumEfficiency(file=str(tmp_path / "qe.csv")), ConversionGain())
        model = CameraModel("linear", campaign.sensor, effects)
        for shot in campaign.shots[:9:4]:
            electrons = mean_electrons(model, ShotSetup(shot, campaign.lights[shot.light]))
            # bands of 5 nm sum the narrow light exactly; the centroid is 550 nm
            assert float(electrons.mean()) == pytest.approx(0.5 * shot.photons_per_pixel, rel=1e-9)


def test_written_as_a_campaign_folder_it_stays_the_same(lab, tmp_path):
    campaign = isetval.load_campaign(lab)
    back = isetval.load_campaign(write_campaign(campaign, tmp_path / "out"))
    assert [s.photons_per_pixel for s in back.shots] == [s.photons_per_pixel for s in campaign.shots]
    one, two = (isetval.measure_campaign(c.only([f"flat_{i:03d}" for i in range(4)])) for c in (campaign, back))
    assert [(m.name, m.value, m.sigma) for m in one.metrics] == [(m.name, m.value, m.sigma) for m in two.metrics]


def test_found_by_content_and_name(lab, tmp_path):
    assert find_emva_descriptor(lab) == lab / "EMVA1288_Data.txt"
    assert find_emva_descriptor(lab / "EMVA1288_Data.txt") == lab / "EMVA1288_Data.txt"
    (tmp_path / "notes.txt").write_text("v is for victory\nn is for no\n")
    assert find_emva_descriptor(tmp_path) is None
    (tmp_path / "other.txt").write_bytes((lab / "EMVA1288_Data.txt").read_bytes())
    assert find_emva_descriptor(tmp_path) == tmp_path / "other.txt"
    assert isetval.load_campaign(lab / "EMVA1288_Data.txt").name == "set"


HEAD = "v 3.0\nn 12 4 3\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (HEAD + "d 40000\ni ../secret.png\n", "leads out of the folder"),
        (HEAD + "d 40000\ni ..\\..\\secret.png\n", "leads out of the folder"),
        (HEAD + "d 40000\ni /etc/passwd\n", "leads out of the folder"),
        (HEAD + "i a.png\n", "line 3: a frame before the first series"),
        (HEAD + "x 1\n", "line 3: 'x 1' is no line"),
        (HEAD + "b 40000\n", "line 3: 'b 40000' is no line"),
        (HEAD + "b forty 3\n", "'forty'; it needs a number"),
        (HEAD + "d -1\n", "'-1'; it needs a number"),
        (HEAD + "d nan\n", "'nan'"),
        ("v 3.0\nn 17 4 3\n", "17 bits"),
        ("v 3.0\nn 12 4.5 3\n", "whole number"),
        ("v 3.0\nn 12 0 3\n", "a size"),
        ("v 3.0\n", "has no line 'n bits columns rows'"),
        (HEAD, "no bright and no dark series"),
        (HEAD + "d 40000\n", "1 series without a frame"),
        (HEAD + "b 40000 5\ni a.png\n", "needs a dark series for the black level, and it lists none"),
        (HEAD + "d 40000\ni a.png\n", "none can be read; the first"),
    ],
)
def test_bad_descriptors(tmp_path, text, words):
    (tmp_path / "EMVA1288_Data.txt").write_text(text)
    with pytest.raises(InputError) as caught:
        isetval.load_campaign(tmp_path)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_frame_that_is_gone_loses_only_itself(lab, tmp_path):
    folder = tmp_path / "set"
    (folder / "images").mkdir(parents=True)
    (folder / "EMVA1288_Data.txt").write_bytes((lab / "EMVA1288_Data.txt").read_bytes())
    for file in (lab / "images").iterdir():
        (folder / "images" / file.name).write_bytes(file.read_bytes())
    (folder / "images" / "b_2_1.png").unlink()
    imageio.v3.imwrite(folder / "images" / "b_3_0.png", np.zeros((80, 90), np.uint16))
    campaign = isetval.load_campaign(folder)
    assert [len(campaign.captures[f"flat_00{i}"]) for i in (1, 2, 3)] == [2, 1, 1]
    reasons = dict(campaign.captures.skipped)
    assert "no such file" in reasons["images/b_2_1.png"]
    assert "80 x 90 pixels, the descriptor says 80 x 96" in reasons["images/b_3_0.png"]


def test_first_exposure_zero(tmp_path):
    """Sets whose first exposure is 0: the time is unknown to a capture, the photon number stands."""
    (tmp_path / "EMVA1288_Data.txt").write_text("v 3.0\nn 8 4 3\nb 0 0\ni a.png\nd 0\ni b.png\n")
    for i, name in enumerate("ab"):
        imageio.v3.imwrite(tmp_path / f"{name}.png", np.arange(12, dtype=np.uint8).reshape(3, 4) + i)
    bright, dark = isetval.load_campaign(tmp_path).shots
    assert (bright.photons_per_pixel, bright.exposure.time_s, dark.exposure.time_s) == (0, None, None)


@pytest.mark.skipif(not REAL.is_dir(), reason="../shared/data/real/emva1288_set001 is not beside this checkout")
def test_the_real_set():
    """README: 50 bright and 50 dark exposures of two frames from 40 us, two stacks of 50 at 5.16 ms; 12 bits, 640 x 480.

    K .28006 DN/e- and QE 45.2 % of the reference implementation say .1266 DN a photon: so does a plain quotient of means.
    """
    campaign = isetval.load_campaign(REAL)
    frames = [shot.frames for shot in campaign.shots]
    assert (sorted(set(frames)), len(frames), sum(frames)) == ([2, 50], 102, 300)
    assert (campaign.sensor.rows, campaign.sensor.cols, campaign.sensor.bits) == (480, 640, 12)
    assert campaign.shots[0].exposure.time_s == pytest.approx(40e-6)
    assert campaign.shots[0].photons_per_pixel == 120
    levels = [shot.light_level for shot in campaign.shots if shot.role == "flat"]
    assert np.ptp(levels) < 0.005
    middle = campaign.shots[17]
    mean_dn = np.mean([c.mosaic for c in campaign.captures[middle.name]]) - campaign.sensor.black_dn[0][0]
    assert mean_dn / middle.photons_per_pixel == pytest.approx(0.28006 * 0.452, rel=0.01)


@pytest.mark.slow
@pytest.mark.skipif(not REAL.is_dir(), reason="../shared/data/real/emva1288_set001 is not beside this checkout")
def test_the_real_set_is_measured():
    """README: gains of .280 to .315 DN/e- by method, dark noise 10.92 e-, PRNU of pixels .265 %."""
    table = isetval.measure_campaign(isetval.load_campaign(REAL))
    found = {(m.name, m.measurement_session): m.value for m in table.metrics if m.summary}
    assert 0.28 < found["gain_dn_per_e", "A"] < 0.315
    assert found["quantum_efficiency", "A"] * found["gain_dn_per_e", "A"] == pytest.approx(45.2 * 0.28006, rel=0.02)
    assert found["read_noise_e", "A"] == pytest.approx(10.92, rel=0.05)
    assert found["prnu", "A"] == pytest.approx(0.265, rel=0.1)


def test_campaign_init_recognises_it_and_the_numbers_stay(lab, tmp_path, capsys):
    import shutil

    from isetval.app.cli import main

    folder = shutil.copytree(lab, tmp_path / "set")
    before = isetval.load_campaign(folder)
    assert main(["campaign", "init", str(folder)]) == 0
    assert "18 shots (9 flat, 9 dark)" in capsys.readouterr().out
    after = isetval.load_campaign(folder)
    names = [f"flat_{i:03d}" for i in range(4)]
    one, two = (isetval.measure_campaign(c.only(names)) for c in (before, after))
    assert [(m.name, m.value, m.sigma) for m in one.metrics] == [(m.name, m.value, m.sigma) for m in two.metrics]
    assert main(["campaign", "init", str(folder)]) == 3
    assert "exists already" in capsys.readouterr().err


@pytest.fixture(scope="module")
def drafted(lab, tmp_path_factory):
    import shutil

    from isetval.app.cli import main

    folder = shutil.copytree(lab, tmp_path_factory.mktemp("drafted") / "set")
    assert main(["campaign", "init", str(folder), "-q"]) == 0
    return folder


def test_init_deals_the_series_and_keeps_the_stacks_for_judging(drafted):
    parts = {name: isetval.load_campaign(drafted / f"campaign_{name}.toml") for name in ("learn", "confirm", "judge")}
    names = [shot.name for part in parts.values() for shot in part.shots]
    assert sorted(names) == sorted(shot.name for shot in isetval.load_campaign(drafted).shots)
    assert {"flat_stack_000", "dark_stack_000"} <= {shot.name for shot in parts["judge"].shots}
    for part in ("learn", "confirm"):  # neighbours over the whole range
        assert [s.role for s in parts[part].shots].count("flat") == 4
    assert all(isetval.measure_campaign(part, summaries=False).metrics for part in parts.values())


def test_init_states_what_nobody_knows_of_the_light(drafted):
    """Photon numbers: one error for all levels, of the width that calibrated photodiodes have; the frame's own is measured."""
    stated = {(n.parameter, n.scope): n.sigma for n in isetval.load_campaign(drafted).nuisances}
    assert stated["light_level", "campaign"] == 0.03
    assert stated["light_level", "frame"] < 0.002  # no flicker was planted: pixel noise of 7680 pixels is .06 % at 9000 photons
    # darks of 7680 pixels without noise of rows: sigma / sqrt(2 x 7680), found from 17 frame means, to a half
    assert stated["black_level.offset_dn", "campaign"] == pytest.approx(READ_DN / np.sqrt(2 * 7680), rel=0.5)


def test_init_drafts_the_linear_camera_of_the_series(drafted):
    """Planted gain, noise and efficiency, each marked as estimated; four levels of 7680 pixels give the gain to some percent."""
    model = isetval.load_model(drafted / "camera.toml")
    assert model.value("conversion_gain.gain_dn_per_e") == pytest.approx(GAIN, rel=0.06)
    assert model.value("read_noise.sigma_e") == pytest.approx(READ_DN / GAIN, rel=0.06)
    assert model.effect("conversion_gain").source.startswith("estimated: ")
    assert model.effect("conversion_gain").fitted_to == ("set, learn",)
    efficiency = float((drafted / "qe.csv").read_text().splitlines()[-1].split(",")[1])
    # the slope of the means is known ten times better than the gain
    assert efficiency * model.value("conversion_gain.gain_dn_per_e") == pytest.approx(QE * GAIN, rel=0.01)
    learned = isetval.load_campaign(drafted / "campaign_learn.toml")
    (row,) = [row for row in isetval.compare(model, learned).ladder if row.family == "flat_mean"]
    assert row.mean_square_z < 4  # four levels: chi2 of four falls above 16 once in 300


def test_of_large_frames_the_middle_is_drafted():
    from isetval.core.campaign import Campaign, Shot
    from isetval.core.sensor import Sensor
    from isetval.files.emva_estimates import LOOKED_AT, looking_at_the_middle

    sensor = Sensor(3000, 4000, 2.0, "MONO", ((0.0, 0.0), (0.0, 0.0)), 4095.0, 12)
    large, words = looking_at_the_middle(Campaign("large", (Shot("dark", "dark"),), sensor=sensor))
    row0, col0, rows, cols = large.shots[0].window
    assert rows * cols <= LOOKED_AT
    assert abs(row0 + rows / 2 - 1500) <= 2
    assert abs(col0 + cols / 2 - 2000) <= 2
    assert (row0 % 2, col0 % 2) == (0, 0)
    assert "middle" in words
    small = Campaign("small", (Shot("dark", "dark"),), sensor=Sensor(240, 320, 2.0, "MONO", ((0.0, 0.0), (0.0, 0.0)), 4095.0, 12))
    assert looking_at_the_middle(small) == (small, "")


def test_saturation_is_where_the_variance_is_largest(lab):
    """Pixels that hold no more than 2000 DN, below the converter's end: the fourth level, of 2020 DN, is the first beyond."""
    from isetval.files.emva_estimates import beyond_saturation

    campaign = isetval.load_campaign(lab)
    flats = [s for s in campaign.shots if s.role == "flat" and s.frames == 2]
    assert beyond_saturation(campaign, flats) == []
    rng = np.random.default_rng(5)
    flat = [f"flat_{i:03d}" for i in range(8)]

    def frames(name):
        dn = np.minimum(BLACK_DN + GAIN * rng.poisson(QE * 4000.0 * (1 + flat.index(name)), (80, 96)), 2000.0)
        return isetval.Capture(np.round(dn).astype(np.uint16), campaign.sensor, (0, 0), Exposure(1e-4))

    clipped = replace(campaign, captures=MemoryCaptures({name: (frames(name), frames(name)) for name in flat}))
    assert [s.name for s in beyond_saturation(clipped, flats)] == [f"flat_{i:03d}" for i in range(3, 8)]


# what sets from other places look like: the working group's documentation and parser allow all of it
@pytest.fixture
def copied(lab, tmp_path):
    """A copy of the laboratory whose descriptor a function rewrites."""
    import shutil

    folder = shutil.copytree(lab, tmp_path / "copy")

    def rewritten(change):
        file = folder / "EMVA1288_Data.txt"
        file.write_bytes(change(file.read_bytes()))
        return folder

    return rewritten


OTHER_WRITINGS = {
    "byte order mark": lambda data: b"\xef\xbb\xbf" + data,
    "tabs": lambda data: b"\n".join(line.replace(b" ", b"\t", 3) for line in data.splitlines()),
    "decimal commas": lambda data: b"\n".join(
        line.replace(b".", b",") if line[:2] in (b"b ", b"d ") else line for line in data.splitlines()
    ),
    "a word for the report": lambda data: data + b"l InterfaceType Gigabit Ethernet\r\n",
    "indented remarks": lambda data: data.replace(b"v 3.0", b"  # a remark\r\n\r\nv 3.0"),
    "forward slashes": lambda data: data.replace(b"\\", b"/"),
    "another computer's disk": lambda data: data.replace(b"images\\", b"C:\\Lab 2\\set\\images\\"),
    "letters of either case": lambda data: data.replace(b"images\\b", b"Images\\B"),
    "frames converted since": lambda data: data.replace(b".png", b".tif"),
}


@pytest.mark.parametrize("writing", OTHER_WRITINGS)
def test_other_writings_of_a_descriptor_give_the_same_campaign(lab, copied, writing):
    folder = copied(OTHER_WRITINGS[writing])
    one, two = isetval.load_campaign(lab), isetval.load_campaign(folder)
    assert [(s.files, s.photons_per_pixel, s.exposure) for s in two.shots] == [
        (s.files, s.photons_per_pixel, s.exposure) for s in one.shots
    ]
    assert two.sensor == one.sensor
    moved = [note for note in two.notes if "do not lie where the descriptor says" in note]
    assert len(moved) == (writing in ("another computer's disk", "letters of either case", "frames converted since"))


def test_two_names_of_one_frame_are_refused(copied):
    folder = copied(lambda data: data.replace(b"images\\b_1_0.png", b"first\\images\\b_0_0.png"))
    with pytest.raises(InputError, match=r"are one file, images/b_0_0.png; give each its own"):
        isetval.load_campaign(folder)


def test_a_path_on_another_disk_whose_frames_are_not_here(copied):
    folder = copied(lambda data: data.replace(b"images\\b_1_0.png", b"D:\\elsewhere\\x.png"))
    with pytest.raises(InputError, match="another computer's disk; copy the frames beside the descriptor"):
        isetval.load_campaign(folder)


def test_codes_beyond_the_stated_bits_are_refused(copied):
    """12 bits in the upper end of 16, as many programs save them; and a line n that is wrong."""
    folder = copied(lambda data: data)
    for file in (folder / "images").iterdir():
        imageio.v3.imwrite(file, imageio.v3.imread(file) << 4)
    with pytest.raises(InputError, match="shifted up by 4 bits: divide them by 16"):
        isetval.load_campaign(folder)
    odd = folder / "images" / "b_7_0.png"
    imageio.v3.imwrite(odd, imageio.v3.imread(odd) | 1)
    with pytest.raises(InputError, match=r"codes to \d+, the line n states 12 bits \(codes to 4095\); write 16 bits"):
        isetval.load_campaign(folder)


def test_a_color_mosaic_is_told(copied):
    folder = copied(lambda data: data)
    for file in (folder / "images").glob("b_*.png"):
        mosaic = imageio.v3.imread(file)
        mosaic[::2, ::2] = BLACK_DN + (mosaic[::2, ::2] - BLACK_DN) // 2
        imageio.v3.imwrite(file, mosaic)
    (told,) = (note for note in isetval.load_campaign(folder).notes if "2 x 2" in note)
    assert "(0.50, " in told
    assert "--camera" in told
    known = load_emva_descriptor(folder / "EMVA1288_Data.txt", cfa="RGGB")
    assert not [note for note in known.notes if "2 x 2" in note]
    assert known.sensor.cfa == "RGGB"


def test_times_that_cannot_be_nanoseconds_are_told(copied):
    folder = copied(lambda data: data.replace(b"0000.0", b"0.0").replace(b"00.0", b"0.0"))
    (told,) = (note for note in isetval.load_campaign(folder).notes if "nanoseconds" in note)
    assert "multiply them" in told


def test_sets_in_sub_folders_and_several_descriptors(lab, tmp_path, capsys):
    import shutil

    from isetval.app.cli import main

    shutil.copytree(lab, tmp_path / "sets" / "A")
    assert main(["campaign", "init", str(tmp_path / "sets")]) == 3
    assert f"isetval campaign init {tmp_path / 'sets' / 'A'}" in capsys.readouterr().err
    for name in ("dark.txt", "bright.txt"):
        (tmp_path / name).write_text(HEAD + "d 40000\ni a.png\n")
    with pytest.raises(InputError, match=r"holds 2 EMVA 1288 descriptors \(bright.txt, dark.txt\); name one"):
        find_emva_descriptor(tmp_path)


def test_few_levels_give_an_efficiency(lab):
    """Three levels cannot show a bend, but they have photon numbers; 5 sigma of the stated error, which stays below 3 %."""
    from isetval.files.emva_estimates import camera_numbers
    from isetval.measure import emva1288

    campaign = isetval.load_campaign(lab)
    few = campaign.only(["flat_001", "flat_004", "flat_007", *(s.name for s in campaign.shots if s.role == "dark")])
    assert camera_numbers(few)["qe_percent"] == pytest.approx(100 * QE, rel=0.06)
    frames = [(c, s.photons_per_pixel) for s in few.shots if s.role == "flat" for c in few.captures[s.name]]
    darks = [c for s in few.shots if s.role == "dark" for c in few.captures[s.name]]
    table = emva1288([c for c, _ in frames], dark=darks, photons_per_pixel=[*(p for _, p in frames), *[None] * len(darks)])
    row = table["MONO", "eta"]
    assert abs(row.value - 100 * QE) < 5 * row.sigma < 15
    assert row.note == ""


def test_light_varied_at_one_exposure_has_a_linearity(lab):
    """EMVA 1288 (R4.0) takes linearity over photons, whichever of time and light was varied."""
    from isetval.measure import emva1288

    campaign = isetval.load_campaign(lab)
    flats = [s for s in campaign.shots if s.role == "flat" and s.frames == 2]
    frames = [(replace(c, exposure=Exposure(1e-3)), s.photons_per_pixel) for s in flats for c in campaign.captures[s.name]]
    darks = [replace(c, exposure=Exposure(1e-3)) for c in campaign.captures["dark_003"]]
    table = emva1288([c for c, _ in frames], dark=darks, photons_per_pixel=[*(p for _, p in frames), None, None])
    for symbol in ("LE_min", "LE_max"):
        row = table["MONO", symbol]
        assert abs(row.value) < 5 * row.sigma < 2  # 2 x 7680 pixels: .1 % of a mean of 170 DN and less above
        assert "over photons" in row.note


def test_a_pattern_is_drafted_where_its_variance_stands_out():
    """A root of variance .0008 +- .0005 stands at 3.1 of its own sigmas and at 1.6 of the variance's: chance, in one of 15."""
    from isetval.files.emva_camera import numbers_of
    from isetval.measure.noise.emva import EmvaRow, EmvaTable

    def table(row_e):
        rows = (("K", 0.2, 0.001), ("sigma_d", 6.0, 0.05), ("DSNU1288.row", row_e, 0.0005 / 2 / row_e), ("mu_c.mean", 9.0, 2.0))
        return EmvaTable(tuple(EmvaRow("MONO", symbol, symbol, value, sigma, "e-") for symbol, value, sigma in rows))

    assert "dsnu_row_e" not in numbers_of(table(np.sqrt(0.0008)))
    assert "dsnu_row_e" in numbers_of(table(np.sqrt(0.0016)))
    assert "dark_current_e_per_s" in numbers_of(table(0.04))
