"""Tests of the C headers: the serial example on a virtual finger, replies against this package, packaging."""

import os
import random
import re
import select
import subprocess
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain, count
from pathlib import Path

import pytest
from fingers import CALIBRATION, ROOT, serve

from taxel import Bias, Channel, Fields, Info, SelfTest
from taxel._postcard import varint, write_varint
from taxel.commands import Command, request
from taxel.packets import Deframer, pack
from taxel.replies import Reply, decode
from taxel.transport import connect

pytestmark = pytest.mark.skipif(os.name != "posix", reason="the example is for POSIX")

C = ROOT / "host-tools/c"
IDLE = f"sim:{ROOT}/host-tools/cli/tests/scenes/idle.toml"
STRICT = "-Wall -Wextra -Wpedantic -Wconversion -Wshadow -Werror"
SANITISED = "-fsanitize=undefined,address -fno-sanitize-recover=all"
SELF_TESTED = 8
FRAME = 2
"""First byte of a message that is a frame."""


def run(*words: object, **options: object) -> str:
    done = subprocess.run(
        [str(word) for word in words], capture_output=True, text=True, timeout=120, **options
    )  # type: ignore[call-overload]
    assert done.returncode == 0, done.stdout + done.stderr
    return str(done.stdout)


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("c")
    run("cmake", "-S", C, "-B", folder, f"-DCMAKE_C_FLAGS={STRICT} {SANITISED}")
    run("cmake", "--build", folder)
    return folder


def test_serial_example_asks_tares_tests_and_streams(command: str, build: Path):
    with serve(command, IDLE) as port:
        said = run(build / "finger", port, 500, 300).splitlines()
    assert said[0] == "firmware 0.1.0, protocol 2"
    assert said[1] == "board virtual, serial idle, 1000 scans a second"
    assert said[2] == "rate 500.000 Hz"
    assert said[3].startswith("self-test: 200 scans, noise at most ") and said[3].endswith("record absent")
    assert said[4].startswith("bias taken, noise 0.000")
    assert len(said) == 9 and all(line.endswith("no value: uncalibrated") for line in said[5:8])
    assert said[8] == "300 frames, 0 lost"


def test_serial_example_prints_newtons(command: str, build: Path):
    with serve(command, IDLE, "--calibration", str(CALIBRATION)) as port:
        said = run(build / "finger", port, 1000, 100)
    assert " 0.000 N\n" in said and "record intact" in said


def test_serial_example_runs_on_the_scene_of_the_readme(command: str, build: Path):
    (scene,) = re.findall(r"`taxel serve --port (sim:\S+)`", (C / "README.md").read_text())
    (rate,) = re.findall(r"`./build/finger PORT (\d+) 300`", (C / "README.md").read_text())
    with serve(command, scene) as port:
        said = run(build / "finger", port, rate, 300).splitlines()
    assert said[4].startswith("bias taken") and said[-1] == "300 frames, 0 lost"
    assert all(line.endswith(" N") for line in said[5:8])


@contextmanager
def renumbered(port: str, seqs: Iterator[int]) -> Iterator[str]:
    """Passes a finger on to a serial port, its frames with these numbers; yields the port's name."""
    master, slave = os.openpty()
    tty.setraw(slave)
    link, deframer = connect(port), Deframer()
    ended = threading.Event()

    def ask() -> None:
        while not ended.is_set():
            if select.select([master], [], [], 0.05)[0]:
                link.write(os.read(master, 512))

    def answer() -> None:
        while not ended.is_set():
            for message in deframer.push(link.read()):
                if message[0] == FRAME:
                    _, after = varint(message, 1)
                    message = bytes([FRAME]) + write_varint(next(seqs)) + message[after:]
                os.write(master, pack(message))

    threads = [threading.Thread(target=work) for work in (ask, answer)]
    for thread in threads:
        thread.start()
    try:
        yield os.ttyname(slave)
    finally:
        ended.set()
        for thread in threads:
            thread.join()
        link.close()
        os.close(slave)
        os.close(master)


def test_serial_example_counts_lost_frames_and_follows_a_restart(command: str, build: Path):
    # 0 lost over the wrap, 3 lost, a duplicate, a restart, 1 lost.
    jumps = [2**32 - 2, 2**32 - 1, 0, 1, 5, 5, 2_147_483_600, 2_147_483_602]
    with (
        serve(command, IDLE, "--tcp", "127.0.0.1:0") as port,
        renumbered(port, chain(jumps, count(2_147_483_603))) as serial,
    ):
        said = run(build / "finger", serial, 500, 100).splitlines()
    assert said[-1] == "100 frames, 4 lost"


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        ([], 2, "usage: finger PORT"),
        (["/dev/no-such-finger"], 1, "No such file"),
        (["PORT", "0"], 1, "out of range: it must be 1 to 1000"),
    ],
)
def test_serial_example_says_what_is_wrong(command: str, build: Path, words: list[str], code: int, says: str):
    with serve(command, IDLE) as port:
        words = [port if word == "PORT" else word for word in words]
        done = subprocess.run([build / "finger", *words], capture_output=True, text=True, timeout=60)
    assert done.returncode == code and says in done.stderr


@pytest.fixture(scope="module")
def messages(command: str) -> list[bytes]:
    """Returns all messages of a session that asks for each reply that C decodes."""
    asked = [
        Command.VERSION,
        Command.INFO,
        Command.set_rate(250),
        Command.set_rate(0),
        Command.set_fields(Fields.ALL),
        Command.take_bias(50),
        Command.READ_BIAS,
        Command.stream(True),
        Command.self_test(50),
        Command.CLEAR_BIAS,
    ]
    found: list[bytes] = []
    with serve(command, IDLE, "--tcp", "127.0.0.1:0", "--calibration", str(CALIBRATION)) as port:
        link, deframer = connect(port), Deframer()
        for tag, words in enumerate(asked):
            link.write(pack(request(tag, words)))
            deadline = time.monotonic() + 10
            while not any(each[0] in (0, 1) and each[1] == tag for each in found):
                assert time.monotonic() < deadline, words
                found += deframer.push(link.read())
        link.close()
    return found


def printed(build: Path, stream: bytes) -> list[str]:
    done = subprocess.run([build / "print_replies"], input=stream, capture_output=True, timeout=120)
    assert done.returncode == 0, done.stderr.decode()
    return done.stdout.decode(errors="replace").splitlines()


def test_replies_are_those_of_this_package(build: Path, messages: list[bytes]):
    lines = printed(build, b"".join(map(pack, messages)))
    ours = {each[1]: decode(each) for each in messages if each[0] in (0, 1) and each[1] != SELF_TESTED}
    assert len(lines) == len(ours) + 1 == 10, lines
    shown = {int(line.split()[0].removeprefix("tag=")): line.partition(" ")[2] for line in lines}
    results = {tag: reply.result for tag, reply in ours.items() if isinstance(reply, Reply)}
    assert shown[0] == "version protocol=2 firmware=0.1.0"
    info = results[1]
    assert isinstance(info, Info) and info.calibration is not None
    assert shown[1] == (
        f"info board={info.board} serial={info.serial} build={info.build} scan_hz={info.scan_hz} "
        f"full_scale={info.full_scale} rate_millihertz={info.rate_millihertz} fields={int(info.fields)} "
        f"streaming={int(info.streaming)} biased={int(info.biased)} calibration={info.calibration.serial} "
        f"scans={info.scans} frames={info.frames} lost={info.lost} overruns={info.overruns} "
        f"bad_packets={info.bad_packets} filter_hz={info.filter_hz}"
    )
    assert shown[2] == "rate millihertz=250000"
    assert shown[3] == "out of range low=1 high=1000"
    assert shown[4] == shown[7] == "done"
    for tag, on_command in ((5, 1), (6, 1), (9, 0)):
        bias = results[tag]
        if isinstance(bias, Bias) and bias.taxels is not None:
            words = dict(word.split("=") for word in shown[tag].split()[1:])
            assert int(words["on_command"]) == on_command == bias.on_command
            values = {f"c{k}": level for k, level in enumerate(bias.taxels.level)} | {
                "noise": bias.taxels.noise
            }
            for s, bridge in enumerate(bias.bridges):
                if bridge is not None:
                    values |= {f"s{s}_{axis}": level for axis, level in enumerate(bridge.level)}
                    values[f"s{s}_noise"] = bridge.noise
            assert {name: float(words[name]) for name in values} == pytest.approx(values, rel=1e-8)
        else:
            assert tag == 9 and shown[tag] == "done"


def test_self_test_is_that_of_this_package(build: Path, messages: list[bytes]):
    (message,) = (each for each in messages if each[:2] == bytes([1, SELF_TESTED]))
    (line,) = printed(build, pack(message))
    reply = decode(message)
    assert isinstance(reply, Reply) and isinstance(reply.result, SelfTest)
    test = reply.result
    parts = {"lit": test.lit, "dark": test.dark, "bridge": sum(test.bridges, ())}
    parts |= {"reference": (test.reference,), "temperature": (test.temperature,)}
    expected = ["scans=50", f"full_scale={test.full_scale}", f"record_intact={test.record_intact:d}"]
    expected += [
        f"{name}{i}={channel.mean:.9g}/{channel.noise:.9g}"
        for name, channels in parts.items()
        for i, channel in enumerate(channels)
        if isinstance(channel, Channel)
    ]
    assert line.split()[2:] == expected and len(expected) > 38


def test_damaged_replies_are_read_without_undefined_behaviour(build: Path, messages: list[bytes]):
    seed = random.Random(1)
    replies = [each for each in messages if each[0] in (0, 1)]
    stream = b""
    for _ in range(4000):
        damaged = bytearray(seed.choice(replies))
        for _ in range(seed.randrange(4)):
            damaged[seed.randrange(len(damaged))] = seed.randrange(256)
        # The checksum is right, so that the decoder sees every byte.
        stream += pack(bytes(damaged[: seed.randrange(1, len(damaged) + 1)]))
    assert 100 < len(printed(build, stream)) < 4000


def test_long_text_is_cut_off_and_the_next_one_is_whole(build: Path, messages: list[bytes]):
    (info,) = (each for each in messages if each[:2] == b"\1\1")
    assert b"\7virtual\4idle" in info
    longer = info.replace(b"\7virtual", write_varint(200) + b"b" * 200)
    (line,) = printed(build, pack(longer))
    assert f"board={'b' * 63} serial=idle build=" in line


def test_field_masks_are_those_of_this_package():
    header = (C / "taxel_command.h").read_text()
    found = {name: 1 << int(bit) for name, bit in re.findall(r"TAXEL_FIELD_(\w+) = 1 << (\d+)", header)}
    assert found == {
        str(field.name): int(field) for field in Fields if field not in (Fields.ALL, Fields.ESTIMATES)
    }


PROGRAM = """
#include <taxel_command.h>
#include <stdio.h>
int main(void) {
    unsigned char packet[TAXEL_MAX_PACKET];
    size_t length = taxel_request(TAXEL_SET_RATE, 1000, 7, packet);
    for (size_t i = 0; i < length; i++) printf("%02x", packet[i]);
    return 0;
}
"""


def test_installed_header_is_found_by_cmake_and_pkg_config(build: Path, tmp_path: Path):
    """Builds a user's program both ways; its packet is the one of this package."""
    run("cmake", "--install", build, "--prefix", tmp_path / "installed")
    (tmp_path / "program.c").write_text(PROGRAM)
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.13)\nproject(user C)\nfind_package(taxel 0.1 REQUIRED)\n"
        "add_executable(user program.c)\ntarget_link_libraries(user taxel::taxel)\n"
    )
    run("cmake", "-S", tmp_path, "-B", tmp_path / "user", f"-DCMAKE_PREFIX_PATH={tmp_path}/installed")
    run("cmake", "--build", tmp_path / "user")
    paths = {**os.environ, "PKG_CONFIG_PATH": str(tmp_path / "installed/share/pkgconfig")}
    flags = run("pkg-config", "--cflags", "taxel", env=paths).split()
    run("cc", *flags, tmp_path / "program.c", "-o", tmp_path / "by-pkg-config")
    expected = pack(request(7, Command.set_rate(1000))).hex()
    assert run(tmp_path / "user/user") == run(tmp_path / "by-pkg-config") == expected


def test_readme_runs_as_written(command: str, tmp_path: Path):
    blocks = re.findall(r"^```sh\n(.*?)^```", (C / "README.md").read_text(), re.MULTILINE | re.DOTALL)
    assert len(blocks) == 2
    (tmp_path / "host-tools").symlink_to(ROOT / "host-tools")
    with serve(command, IDLE) as port:
        for block in blocks:
            run("bash", "-euo", "pipefail", "-c", block.replace("/dev/ttyACM0", port), cwd=tmp_path)
