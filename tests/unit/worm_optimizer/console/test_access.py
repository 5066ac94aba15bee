# SPDX-License-Identifier: Apache-2.0
"""Access to the console: by the origin of a request, by a secret, and for a limited time."""

import pytest

from worm_optimizer.console.access import SESSION_S, Access, is_local, same_origin


class Clock:
    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.mark.parametrize(
    ("origin", "same"),
    [
        (None, True),
        ("http://robot:8080", True),
        ("http://robot:8081", False),
        ("http://evil.example", False),
        ("http://robot:8080.evil.example", False),
        ("null", False),
        ("", False),
    ],
)
def test_only_pages_of_the_console_are_of_its_origin(origin: str | None, same: bool):
    headers = {"host": "robot:8080"} | ({} if origin is None else {"origin": origin})
    assert same_origin(headers) is same


@pytest.mark.parametrize("host", ["localhost:8080", "127.0.0.1:8080", "[::1]:8080", "localhost"])
def test_without_a_secret_this_computer_has_access(host: str, clock: Clock):
    assert Access("", clock).admits({"host": host, "origin": f"http://{host}"}, "")


@pytest.mark.parametrize("host", ["evil.example:8080", "", "127.0.0.1.evil.example", "192.168.0.4"])
def test_without_a_secret_another_name_of_this_computer_has_no_access(host: str, clock: Clock):
    """Otherwise a page of a foreign server whose name resolves to 127.0.0.1 would have access (DNS rebinding)."""
    assert not Access("", clock).admits({"host": host}, "")


def test_with_a_secret_only_sessions_have_access(clock: Clock):
    access = Access("right", clock)
    assert not access.admits({"host": "robot"}, "")
    assert not access.admits({"host": "robot"}, "invented")
    assert access.sign_in("wrong", "10.0.0.1") == ""
    session = access.sign_in("right", "10.0.0.1")
    assert access.admits({"host": "robot"}, session)
    assert not access.admits({"host": "robot", "origin": "http://evil.example"}, session)


def test_sessions_end(clock: Clock):
    access = Access("right", clock)
    first, second = access.sign_in("right", "10.0.0.1"), access.sign_in("right", "10.0.0.1")
    access.sign_out(first)
    assert not access.is_open(first)
    clock.now = SESSION_S - 1.0
    assert access.is_open(second)
    clock.now = SESSION_S
    assert not access.is_open(second)


def test_ten_wrong_secrets_lock_sign_ins_for_a_minute(clock: Clock):
    access = Access("right", clock)
    for _ in range(10):
        assert access.lock_s("10.0.0.1") == 0.0
        access.sign_in("wrong", "10.0.0.1")
    clock.now += 20.0
    assert access.lock_s("10.0.0.1") == 40.0
    assert access.sign_in("right", "10.0.0.2"), "others are not locked"
    for _ in range(10):  # attempts during the lock do not extend it
        assert access.sign_in("right", "10.0.0.1") == ""
    clock.now += 40.0
    assert access.lock_s("10.0.0.1") == 0.0
    assert access.sign_in("right", "10.0.0.1")


def test_what_is_local():
    assert is_local("127.0.0.1")
    assert not is_local("0.0.0.0")


@pytest.mark.parametrize("headers", [{"host": "["}, {"host": "localhost", "origin": "http://["}])
def test_a_malformed_host_or_origin_is_not_admitted(clock: Clock, headers: dict[str, str]):
    assert not Access("", clock).admits(headers, "")
