from __future__ import annotations

import tomllib
from enum import StrEnum
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel

from fusion.estimator.config import FusionConfig
from fusion.settings.sentences import section_of
from fusion.settings.toml import config_toml, settings_text
from fusion.settings.unit_hints import as_number, suggestion, too_large, unit_of
from fusion.simulate import SimulationConfig
from vision.errors import InputError


def refusal(
    tmp_path: Path, text: str, model: type[FusionConfig] | type[SimulationConfig] = FusionConfig
) -> str:
    path = tmp_path / "my.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as error:
        model.from_toml(path)
    message = str(error.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    return message.removeprefix(f"{path}: ")


class TestPrinted:
    @pytest.mark.parametrize("simulate", [False, True])
    def test_the_defaults_come_back_as_they_were(self, tmp_path: Path, simulate: bool) -> None:
        model = SimulationConfig if simulate else FusionConfig
        path = tmp_path / "all.toml"
        path.write_text(settings_text(model, "corridor x"), encoding="utf-8")
        assert model.from_toml(path) == model()

    def test_every_setting_is_there_with_its_meaning(self) -> None:
        text = " ".join(settings_text(FusionConfig, "corridor fuse FLIGHT").replace("\n# ", " ").split())
        for name, field in FusionConfig.model_fields.items():
            assert f" {name} = " in text
            words = (field.description or "").replace("None:", "").split()
            assert " ".join(words[-3:]) in text

    def test_what_a_file_set_is_marked_with_its_default(self, tmp_path: Path) -> None:
        path = tmp_path / "my.toml"
        path.write_text("corridor_width_m = 2.2\nmin_lines = 6\n")
        text = settings_text(FusionConfig, "corridor fuse FLIGHT", path)
        assert "corridor_width_m = 2.2  # m; from 0.2 to 100; default: not set" in text
        assert "min_lines = 6  # from 2 to 1000; default 4" in text
        assert "# camera_height_m = ...  # m; above 0.01 to 100; not set" in text
        assert "imu_yaw_std_rad = 0.008726646259971648  # rad (0.5 degrees); above 0 to 1" in text
        assert 'imu_yaw_use = "auto"  # auto, always or never' in text
        path.write_text(text)
        assert FusionConfig.from_toml(path) == FusionConfig(corridor_width_m=2.2, min_lines=6)

    def test_sections_lists_and_tables_of_a_simulation_come_back(self) -> None:
        values = {
            "seed": 7,
            "scene": {
                "end": "window",
                "lamp_size_m": [0.3, 1.2],
                "junctions": [{"at_m": 9.0}, {"at_m": 12.0}],
            },
            "camera": {"distortion": "radtan", "coefficients": [-0.1, 0.01, 0.0, 1e-5]},
            "imaging": {"jpeg_quality": 70},
            "motion": {"route": [2]},
        }
        config = SimulationConfig.from_values(values)
        assert SimulationConfig.from_values(tomllib.loads(config_toml(config, "Mine."))) == config

    @given(st.floats(1e-9, 0.999), st.floats(1e-300, 1.0))
    def test_every_float_comes_back_to_the_last_bit(self, yaw: float, gap: float) -> None:
        config = FusionConfig(imu_yaw_std_rad=yaw, gyro_gap_s=gap)
        assert FusionConfig(**tomllib.loads(config_toml(config, ""))) == config

    def test_text_is_quoted(self) -> None:
        class Colour(StrEnum):
            RED = "red"

        class Words(BaseModel):
            word: str = 'say "a\\b"\n'
            colour: Colour = Colour.RED
            on: bool = True

        assert Words(**tomllib.loads(config_toml(Words(), ""))) == Words()


def test_every_number_with_a_dimension_has_a_unit() -> None:
    plain = ("gate_sigma", "start_frames", "gyro_scale_std")
    for model in (FusionConfig, *(section_of(f) for f in SimulationConfig.model_fields.values())):
        for name, field in model.model_fields.items() if model else ():
            if field.annotation in (float, float | None) and name.endswith(("density", "walk")):
                assert "sqrt" in unit_of(name, field.description), name
    for name, field in FusionConfig.model_fields.items():
        if field.annotation in (float, float | None) and name not in plain:
            assert unit_of(name, field.description), name


class TestRefused:
    @pytest.mark.parametrize(
        ("text", "message"),
        [
            (
                "corridor_width_cm = 220",
                "unknown setting corridor_width_cm = 220 (did you mean corridor_width_m = 2.2?)",
            ),
            (
                "camera_delay_ms = 20",
                "unknown setting camera_delay_ms = 20 (did you mean camera_delay_s = 0.02?)",
            ),
            (
                "recovery_spread_deg = 1.5",
                "unknown setting recovery_spread_deg = 1.5 (did you mean recovery_spread_rad = 0.0261799388?)",
            ),
            (
                "gyro_bias_std_dps = 1",
                "unknown setting gyro_bias_std_dps = 1 (did you mean gyro_bias_std_rad_s = 0.0174532925?)",
            ),
            (
                "position_dead_band_percent = 10",
                "unknown setting position_dead_band_percent = 10 (did you mean position_dead_band_norm = 0.1?)",
            ),
            (
                "heading_gate_deg = 4",
                "unknown setting heading_gate_deg = 4 "
                "(did you mean heading_gate_sigma? It is in sigma, not in degrees)",
            ),
            (
                "corridor_width = 2",
                "unknown setting corridor_width = 2 (did you mean corridor_width_m? It is in m)",
            ),
            (
                "coridor_widht_cm = 220",
                "unknown setting coridor_widht_cm = 220 (did you mean corridor_width_m = 2.2?)",
            ),
            (
                "gyro_noise_density_dps = 3",
                "unknown setting gyro_noise_density_dps = 3 "
                "(did you mean gyro_noise_density? It is in rad/s/sqrt(Hz), not in degrees/s)",
            ),
            ("min_line = 3", "unknown setting min_line = 3 (did you mean min_lines?)"),
            ("zzz = 3", "unknown setting zzz = 3 (`corridor config` lists them all)"),
            (
                "[fuse]\nmin_lines = 3",
                "unknown setting fuse = {...}, a section "
                "(write min_lines without a section, at the top of the file)",
            ),
            (
                '[imu]\nframe = "flu"',
                "unknown setting imu = {...}, a section (this file has none; "
                "those of a flight, such as [imu] and [camera], belong in its flight.toml)",
            ),
            ("corridor_width_m = true", "corridor_width_m = true: input should be a number"),
            (
                "corridor_width_m = 220",
                "corridor_width_m = 220: input should be less than or equal to 100 "
                "(it is in m; 220 centimetres are 2.2)",
            ),
            (
                "heading_std_floor_rad = 3.0",
                "heading_std_floor_rad = 3.0: input should be less than or equal to 1 "
                "(it is in rad; 3 degrees are 0.0523599)",
            ),
            ("imu_yaw_use = 'of'", "imu_yaw_use = 'of': input should be 'auto', 'always' or 'never'"),
        ],
    )
    def test_the_line_names_setting_value_and_remedy(self, tmp_path: Path, text: str, message: str) -> None:
        assert refusal(tmp_path, text) == message

    def test_a_quantity_as_text_is_converted(self, tmp_path: Path) -> None:
        message = refusal(tmp_path, "corridor_width_m = '220 cm'")
        assert message.startswith("corridor_width_m = '220 cm': ")
        assert message.endswith("(write a number in m: corridor_width_m = 2.2)")

    def test_an_unknown_name_is_told_before_a_wrong_value(self, tmp_path: Path) -> None:
        assert refusal(tmp_path, "min_lines = 1\ncorridor_width_cm = 220").startswith(
            "unknown setting corridor_width_cm"
        )

    def test_the_path_into_a_section_is_named(self, tmp_path: Path) -> None:
        message = refusal(tmp_path, "[motion]\nheading_amplitude_deg = 20", SimulationConfig)
        assert message == (
            "unknown setting motion.heading_amplitude_deg = 20 (did you mean heading_amplitude_rad = 0.34906585?)"
        )
        message = refusal(tmp_path, "[[scene.junctions]]\nat_m = 5\nwidth_cm = 200", SimulationConfig)
        assert message == "unknown setting scene.junctions.0.width_cm = 200 (did you mean width_m = 2?)"
        assert "did you mean imaging?" in refusal(tmp_path, "[imagin]\nnoise = false", SimulationConfig)
        assert refusal(tmp_path, "[camera]\nrate_hz = true", SimulationConfig) == (
            "camera.rate_hz = true: input should be a number"
        )


def test_units_of_names() -> None:
    assert unit_of("gyro_bias_std_rad_s", None) == "rad/s"
    assert unit_of("recovery_spread_rad", None) == "rad"
    assert unit_of("velocity_std_m_s", None) == "m/s"
    assert unit_of("imu_yaw_walk", "Random walk of the yaw, rad/sqrt(s).") == "rad/sqrt(s)"
    assert unit_of("gyro_bias_walk", "rad/s^2/sqrt(Hz); None: as declared") == "rad/s^2/sqrt(Hz)"
    assert unit_of("min_lines", "Lines that must meet.") == ""


def test_hints_say_nothing_where_they_know_nothing() -> None:
    assert suggestion("wing_span_furlongs", 3, {"min_lines": "", "buffer_s": "s"}) is None
    assert suggestion("delay_ms", "soon", {"delay_s": "s"}) == "did you mean delay_s, in s?"
    assert as_number("corridor_width_m", "wide") is None
    assert as_number("corridor_width_m", "3 parsecs") is None
    assert as_number("corridor_width_m", "3 deg") == "it is in m, not in degrees"
    assert too_large("min_lines", 5000) is None
    assert too_large("corridor_width_m", True) is None
