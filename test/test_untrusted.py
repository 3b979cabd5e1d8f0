# SPDX-License-Identifier: BSD-3-Clause
"""A bag, a URDF and a configuration are input: no path out of their folder, no bomb, no entities, no evaluated text."""

from __future__ import annotations

import io
import re

import pytest
import zstandard
from mcap.writer import CompressionType, Writer
from synthetic import description, walk, write_bag

from coman_reduced_model.bag.chunks import LARGEST, decompressed
from coman_reduced_model.bag.reader import Bag
from coman_reduced_model.cli.main import run
from coman_reduced_model.core.config.files import load_config
from coman_reduced_model.core.config.schema import Config
from coman_reduced_model.core.robot.discover import build_model
from coman_reduced_model.core.robot.robot import Robot
from coman_reduced_model.core.robot.sole import mesh_points
from coman_reduced_model.errors import ComanError, ConfigError, RobotError


def test_files_that_metadata_names_elsewhere_are_not_read(tmp_path):
    secret = write_bag(tmp_path / "secret", walk(0.1))
    bag = write_bag(tmp_path / "bag", walk(0.1))
    text = (bag / "metadata.yaml").read_text()
    for elsewhere in ("../secret/secret.mcap", str(next(secret.glob("*.mcap"))), ".."):
        (bag / "metadata.yaml").write_text(text.replace(next(bag.glob("*.mcap")).name, elsewhere))
        with Bag(bag) as opened:
            assert any("read file by file" in line for line in opened.warnings)


@pytest.mark.parametrize("method", ["zstd", "lz4"])
def test_chunks_that_grow_too_much_are_not_decompressed(method):
    import lz4.frame

    zeros = bytes(LARGEST + 2**20)
    small = zstandard.ZstdCompressor().compress(zeros) if method == "zstd" else lz4.frame.compress(zeros)
    del zeros
    assert len(small) < LARGEST / 100
    with pytest.raises(ValueError, match="more than 256 MB"):
        decompressed(method.encode(), small)


@pytest.mark.parametrize("indexed", [True, False])
def test_a_bag_that_is_a_bomb_is_one_line(tmp_path, indexed):
    path, stream = tmp_path / "bomb.mcap", io.BytesIO()
    writer = Writer(stream, chunk_size=2**31, compression=CompressionType.ZSTD)
    writer.start()
    schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
    channel = writer.register_channel("/robot_description", "cdr", schema)
    writer.add_message(channel, 1, bytes(LARGEST + 2**20), 1)
    writer.finish()
    path.write_bytes(stream.getvalue() if indexed else stream.getvalue()[:-100])
    assert path.stat().st_size < 2**20
    assert run(["predict", str(path), "--out", str(tmp_path / "out")]) == 2


def test_a_file_that_is_a_bomb_is_refused(tmp_path):
    path = tmp_path / "bomb.mcap.zstd"
    path.write_bytes(zstandard.ZstdCompressor().compress(b"\x89MCAP0\r\n" + bytes(LARGEST + 2**25)))
    with pytest.raises(ComanError, match="not decompressed"):
        Bag(path)


LAUGHS = '<!DOCTYPE r [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;">]>'


@pytest.mark.parametrize("head", [LAUGHS, '<!DOCTYPE r [<!ENTITY f SYSTEM "file:///etc/passwd">]>'])
def test_entities_are_refused(head):
    with pytest.raises(RobotError, match="entities"):
        Robot(head + description(), Config().robot)


@pytest.mark.parametrize("name", ["../foot.stl", "file://{}/foot.stl", "package://../foot.stl", "link.stl", "x" * 5000])
def test_meshes_elsewhere_are_not_read(tmp_path, name):
    foot = tmp_path / "foot.stl"
    foot.write_text("solid f\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex .1 0 0\nvertex 0 .1 0\n"
                    "endloop\nendfacet\nendsolid f\n")  # fmt: skip
    inside = tmp_path / "inside"
    inside.mkdir()
    (inside / "link.stl").symlink_to(foot)
    plain = re.sub(r"<collision>.*?</collision>", "", description(), flags=re.DOTALL)
    model = build_model(plain, "URDF")
    sole = model.getFrameId("l_sole")

    def points(file, folder):
        mesh = f'<link name="l_sole"><collision><geometry><mesh filename="{file}"/></geometry></collision>'
        text = re.sub(r'<link name="l_sole"\s*/?>', mesh if '"l_sole">' in plain else f"{mesh}</link>", plain)
        return mesh_points(text, model, sole, folder)

    assert len(points("foot.stl", tmp_path)) == 3, "beside the URDF it is read"
    assert not len(points(name.format(tmp_path), inside))


@pytest.mark.parametrize(
    "text",
    [
        "/**: {ros__parameters: !!python/object/apply:os.system ['false']}",
        "a: &a {b: 1}\n/**: {ros__parameters: {x: *a}}",
        "/**: {ros__parameters: " + "[" * 5000,
    ],
    ids=["object", "alias", "nested"],
)
def test_configurations_hold_plain_values(tmp_path, text):
    (tmp_path / "c.yaml").write_text(text)
    with pytest.raises(ConfigError):
        load_config(tmp_path / "c.yaml")
    assert run(["config", str(tmp_path / "c.yaml")]) == 2


def test_names_from_a_bag_are_escaped_in_its_report(tmp_path):
    evil = "<script>alert(1)</script>"
    text = description().replace('name="base_link"', 'name="base_link" ')
    bag = write_bag(tmp_path / "<b>bag$x^{", walk(1.0), urdf_text=text)
    out = tmp_path / "out"
    settings = ["--set", f"robot.name={evil}", "--set", "prediction.reference=none"]
    assert run(["predict", str(bag), "--out", str(out), *settings]) == 0
    assert run(["report", str(out)]) == 0
    page = (out / "report.html").read_text()
    assert evil not in page and "<b>bag" not in page and "&lt;script&gt;alert" in page
