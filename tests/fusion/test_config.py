from __future__ import annotations

import copy
import pickle
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from fusion.estimator.config import FusionConfig
from fusion.live.settings import LiveSettings
from fusion.simulate import SimulationConfig
from tests.files import written
from vision.errors import InputError


def test_file_sets_what_it_names(tmp_path: Path) -> None:
    config = FusionConfig.from_toml(
        written(tmp_path / "settings.toml", "corridor_width_m = 2.2\nmin_lines = 6\n")
    )
    assert config.corridor_width_m == 2.2
    assert config.min_lines == 6
    assert config.buffer_s == FusionConfig().buffer_s


def test_unknown_name_is_refused_with_the_nearest(tmp_path: Path) -> None:
    path = written(tmp_path / "settings.toml", "coridor_width = 2.5\n")
    with pytest.raises(
        InputError, match=r"settings\.toml: unknown setting coridor_width = 2\.5 \(did you mean"
    ) as error:
        FusionConfig.from_toml(path)
    assert "corridor_width_m" in str(error.value)
    assert "\n" not in str(error.value)


def test_section_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="unknown setting filter"):
        FusionConfig.from_toml(written(tmp_path / "settings.toml", "[filter]\nmin_lines = 5\n"))


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("corridor_width_m = -1.0", "corridor_width_m = -1.0"),
        ("corridor_width_m = 'wide'", "corridor_width_m = 'wide'"),
        ("camera_delay_s = nan", "camera_delay_s"),
        ("min_lines = 4.5", "min_lines = 4.5"),
        ("camera_delay_s = 0.6", "less than buffer_s = 0.5"),
        ("lost_after_s = 0.1", "less than coasting_after_s"),
        ("corridor_width_m =", "is not TOML"),
        ("min_lines = 4\ncorridor_width_m = 2,2  # wide", "(write a decimal point: corridor_width_m = 2.2)"),
    ],
)
def test_bad_value_is_named(tmp_path: Path, line: str, message: str) -> None:
    with pytest.raises(InputError) as error:
        FusionConfig.from_toml(written(tmp_path / "settings.toml", line))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nothing\.toml: cannot be read"):
        FusionConfig.from_toml(tmp_path / "nothing.toml")


def test_frozen_and_described() -> None:
    with pytest.raises(ValidationError):
        FusionConfig().min_lines = 5
    assert all(field.description for field in FusionConfig.model_fields.values())


@pytest.mark.parametrize(
    ("model", "values", "message"),
    [
        (
            FusionConfig,
            {"corridor_width_m": 220},
            "corridor_width_m = 220: input should be less than or equal to 100",
        ),
        (FusionConfig, {"corridor_widht_m": 2.2}, "did you mean corridor_width_m = 2.2?"),
        (FusionConfig, {"min_lines": True}, "min_lines = true: input should be a number"),
        (
            SimulationConfig,
            {"motion": {"duration_s": -2}},
            "motion.duration_s = -2: input should be greater than",
        ),
        (
            SimulationConfig.random_office,
            {"seed": 1, "camera": {"width": 8}},
            "unknown setting camera.width = 8",
        ),
        (LiveSettings, {"rate_hz": 0.0}, "rate_hz = 0.0: input should be greater than or equal to 1"),
    ],
)
def test_a_wrong_setting_is_one_line_from_python_too(
    model: Any, values: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError) as error:
        model(**values)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("model", [FusionConfig, LiveSettings, SimulationConfig])
def test_a_setting_without_its_name_is_refused(model: Any) -> None:
    with pytest.raises(InputError, match=rf"{model.__name__}\(2\.2\) does not say which .*name it, as in"):
        model(2.2)


def test_settings_can_be_sent_to_another_process() -> None:
    config = FusionConfig(corridor_width_m=2.2)
    assert pickle.loads(pickle.dumps(config)) == config == copy.deepcopy(config)


def test_noise_left_open_has_defaults() -> None:
    config = FusionConfig()
    assert (config.gyro_noise, config.bias_walk) == (0.0075, 1e-4)
    assert config.offset_walk == pytest.approx(1.2 * 0.0075)
    config = FusionConfig(gyro_noise_density=0.001, imu_yaw_walk=0.5)
    assert (config.gyro_noise, config.offset_walk) == (0.001, 0.5)
