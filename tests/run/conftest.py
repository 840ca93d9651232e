"""Scenes of these tests as files."""

import pytest

import dropper_jax as dj


@pytest.fixture
def file_of(tmp_path):
    """`file_of(scene)`: a scene or its plain values as a file, for commands."""

    def write(scene):
        file = tmp_path / "scene.toml"
        file.write_text(dj.as_toml(scene if isinstance(scene, dict) else scene.to_dict()), encoding="utf-8")
        return str(file)

    return write
