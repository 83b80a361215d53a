"""A daemon, a broker, a backend that listens, and the process between them."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from mqtt_daemon import FakeDaemon
from mqtt_fake_broker import FakeBroker
from mqtt_mosquitto import Mosquitto, Subscriber
from mqtt_process import Process, write_config


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[FakeDaemon]:
    fake = FakeDaemon(tmp_path)
    fake.start()
    yield fake
    fake.stop()


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Mosquitto]:
    started = Mosquitto(tmp_path)
    started.start()
    yield started
    started.stop()


@pytest.fixture
def backend(broker: Mosquitto) -> Iterator[Subscriber]:
    subscriber = Subscriber(broker.port)
    yield subscriber
    subscriber.close()


@pytest.fixture
def process(tmp_path: Path, daemon: FakeDaemon, broker: Mosquitto, backend: Subscriber) -> Iterator[Process]:
    started = Process(write_config(tmp_path, broker.port))
    yield started
    started.kill()


@pytest.fixture
def fake() -> Iterator[FakeBroker]:
    started = FakeBroker()
    yield started
    started.close()
