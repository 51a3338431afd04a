"""Files on their way from a node to the driver, without Ray: the folders of two ends."""

import os
import pickle
import shutil

import numpy as np
import pytest

from agents.training.files import write_whole
from agents.training.transfer import Sent, take_in

BIG = 100_000


@pytest.fixture
def ends(tmp_path):
    """Two equal folders, and what the first has sent to the second."""
    rng = np.random.default_rng(0)
    node, driver = tmp_path / "node", tmp_path / "driver"
    (node / "seed-0").mkdir(parents=True)
    write_whole(node / "checkpoint.npz", rng.bytes(BIG))
    np.save(node / "seed-0" / "costs.npy", rng.random(BIG))
    shutil.copytree(node, driver)
    return node, driver, Sent((node,)), rng


def content(folder):
    return {
        path.relative_to(folder): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name != ".lock"
    }


def send(ends, status=None):
    """Bytes of a message, after which both folders are equal."""
    node, driver, sent, _ = ends
    message = sent.changes(status)
    take_in((driver,), message)
    assert content(driver) == content(node)
    return len(pickle.dumps(message))


def write_checkpoint(node, rng):
    write_whole(node / "checkpoint.npz", rng.bytes(BIG), keep=node / "checkpoint.previous.npz")


def test_rows_that_were_sent_are_not_sent_again(ends):
    node, *_, rng = ends
    path = node / "seed-0" / "costs.npy"
    for _ in range(3):
        np.save(path, np.concatenate([np.load(path), rng.random(1000)]))
        write_checkpoint(node, rng)
        assert BIG + 8_000 < send(ends) < BIG + 8_000 + 2_000
    assert len(np.load(ends[1] / "seed-0" / "costs.npy")) == BIG + 3_000


def test_other_rows_are_sent_whole(ends):
    """Of a run that was put back to an earlier checkpoint, and files that are shorter."""
    node, *_, rng = ends
    path = node / "seed-0" / "costs.npy"
    for rows in (BIG, BIG + 10, BIG // 2, 3, 0, 7):
        np.save(path, rng.random(rows))
        write_checkpoint(node, rng)
        assert send(ends) > BIG + 8 * rows


def test_a_checkpoint_that_takes_the_place_of_another(ends):
    """As where the last one is damaged."""
    node, *_, rng = ends
    write_checkpoint(node, rng)
    send(ends)
    os.replace(node / "checkpoint.previous.npz", node / "checkpoint.npz")
    assert send(ends) < 2_000


def test_between_the_moves_of_a_checkpoint(ends):
    """There is the one before alone; then the new one comes."""
    node, *_, rng = ends
    os.replace(node / "checkpoint.npz", node / "checkpoint.previous.npz")
    assert send(ends) < 2_000
    write_whole(node / "checkpoint.npz", rng.bytes(BIG))
    assert BIG < send(ends) < BIG + 2_000


def test_progress_alone(ends):
    """Nothing else is sent before there is a checkpoint, or the end."""
    node, driver, sent, rng = ends
    assert sent.changes(None) is None
    np.save(node / "seed-0" / "costs.npy", rng.random(5))
    assert sent.changes(None) is None
    write_whole(node / "status.json", b"{}")
    message = sent.changes(None)
    assert ([file.name for file in message.files], message.names) == (["status.json"], None)
    take_in((driver,), message)
    assert (driver / "status.json").read_bytes() == b"{}"
    assert sent.changes(None) is None
    send(ends, status=0)
