"""Scenes in a log: decoded by the viewer's own schema, beside the twin's forward kinematics."""

import msgspec
import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader

from firmware_py.core.signals import tick_dtype
from firmware_py.link.marker_layout import square_layout
from firmware_py.log.recorder import recording
from firmware_py.log.scene import (
    EVERY,
    SCENE_TOPIC,
    SHAPE_KEY,
    LinkShape,
    scene_schema,
    shape_of_plant,
)
from models.plant.document import plain_plant
from models.plant.plant import NOMINAL, read_plant
from models.shared.kinematics import base_corners_m, base_rotation

OFFSET_M, LENGTH_M, WIDTH_M, POSITION, RATIO = 0.06, 0.95, 0.15, 1 / 3, 1.2
LAYOUT = square_layout(LENGTH_M, WIDTH_M)
SHAPE = LinkShape(OFFSET_M, LENGTH_M, LAYOUT.rows_m, LAYOUT.corners_m, RATIO)
ROUNDING_M = 1e-4
TICKS = 3 * EVERY


def twin_points_m(angle_rad, root_rad):
    """Span hinge and tip as the twin's two hinges place them, for bends in the ratio of SHAPE."""
    root, span = np.asarray(root_rad), RATIO * np.asarray(root_rad)
    base, first, second = (base_rotation(np.atleast_2d(q))[0] for q in (angle_rad, root, span))
    plate = base @ (0, 0, OFFSET_M)
    hinge = plate + base @ first @ (0, 0, POSITION * LENGTH_M)
    return hinge, hinge + base @ first @ second @ (0, 0, (1 - POSITION) * LENGTH_M)


def test_the_shape_comes_from_the_plant():
    assert shape_of_plant({}) is None
    plant = read_plant(NOMINAL)
    document = plain_plant(plant.document())
    shape = shape_of_plant(document)
    value = {name: q.value for name, q in plant.parameters.items()}
    ratio = value["root_stiffness_1_nm_rad"] / value["span_stiffness_1_nm_rad"]
    assert shape.bend_ratio == pytest.approx((1 - value["span_position"]) * ratio)
    assert (shape.length_m, len(shape.rows_m)) == (value["link_length_m"], 4)
    del document["parameters"]["span_position"]
    assert shape_of_plant(document) is None  # another plant has no such scene


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """Log of a recorder process: a bent link that swings."""
    path = tmp_path_factory.mktemp("scene") / "run.mcap"
    metadata = {SHAPE_KEY: msgspec.json.encode(SHAPE).decode()}
    records = np.zeros(TICKS, tick_dtype(2))
    records["tick"] = np.arange(TICKS)
    records["time_s"] = 0.017 * np.arange(TICKS)
    records["angle_1_rad"] = np.linspace(0.0, 0.4, TICKS)
    for k, axis in enumerate("xyz"):
        tips = [twin_points_m((q, 0.0), (0.05, 0.02))[1][k] for q in records["angle_1_rad"]]
        records[f"predicted_tip_{axis}_m"] = tips
        records[f"half_width_{axis}_m"] = 0.02
    records["in_range"] = 1
    records["predicted_tip_x_m"][EVERY] = np.nan  # a tick without a prediction has no scene
    with recording(path, 2, 10**18, metadata) as telemetry:
        for record in records:
            telemetry.put(memoryview(record.tobytes()))
    return path, records


def decoded(path):
    """Scenes of a log, by the schema that the log itself holds."""
    with open(path, "rb") as stream:
        scenes = list(make_reader(stream).iter_messages(topics=[SCENE_TOPIC]))
    schema = scenes[0][0]
    assert (schema.name, schema.encoding) == ("foxglove.SceneUpdate", "protobuf")
    files, pool = descriptor_pb2.FileDescriptorSet(), descriptor_pool.DescriptorPool()
    files.ParseFromString(schema.data)
    for file in files.file:
        pool.Add(file)
    scene = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
    return [(message.log_time, scene.FromString(message.data)) for _, _, message in scenes]


def xyz(point):
    return (point.x, point.y, point.z)


def test_a_log_shows_link_markers_and_tip_where_the_twin_has_them(log):
    path, records = log
    messages = pytest.importorskip("foxglove.messages")
    assert scene_schema() == messages.SceneUpdate.get_schema().data
    scenes = decoded(path)
    assert len(scenes) == TICKS // EVERY - 1
    for time_ns, scene in scenes:
        tick = records[round((time_ns - 10**18) / 17e6)]
        entities = {e.id: e for e in scene.entities}
        assert set(entities) == {"link", "markers", "tip"}
        assert {e.frame_id for e in scene.entities} == {"world"}
        stamp = entities["link"].timestamp
        assert stamp.seconds * 10**9 + stamp.nanos == time_ns
        _, tip = twin_points_m((tick["angle_1_rad"], 0.0), (0.05, 0.02))
        (ball,) = entities["tip"].spheres
        np.testing.assert_allclose(xyz(ball.pose.position), tip, atol=ROUNDING_M)
        assert ball.size.x == pytest.approx(0.04, abs=ROUNDING_M)
        places = np.array([xyz(s.pose.position) for s in entities["markers"].spheres])
        assert places.shape == (16, 3)
        np.testing.assert_allclose(places[12:].mean(axis=0), tip, atol=ROUNDING_M)
        centre, rigid = entities["link"].lines
        plate = base_corners_m(np.array([[tick["angle_1_rad"]]]), OFFSET_M, [(0.0, 0.0)])[0, 0]
        np.testing.assert_allclose(xyz(centre.points[0]), plate, atol=ROUNDING_M)
        steps_m = np.linalg.norm(np.diff([xyz(p) for p in centre.points], axis=0), axis=1)
        assert steps_m.sum() == pytest.approx(LENGTH_M, rel=5e-3), "a bent link keeps its length"
        assert len(rigid.points) == 2
        (skin,) = entities["link"].triangles
        assert max(skin.indices) == len(skin.points) - 1
        assert len(skin.indices) % 3 == 0
