# SPDX-License-Identifier: Apache-2.0
"""Claims of a namespace, among real processes."""

import os
import subprocess
import sys

import pytest

from worm_msgs.claim import DRIVER, ROBOT, ClaimedError, claim, claim_robot, domain_of, holder

DOMAIN = 100_000 + os.getpid()  # a domain that no other test uses at the same time

CLAIMANT = """
import sys
from worm_msgs.claim import ClaimedError, claim
# claims at the first line that it reads, and ends at the second
sys.stdin.readline()
try:
    made = claim("virtual robot or player", "/worm", int(sys.argv[1]))
    print("claimed", flush=True)
except ClaimedError:
    print("rejected", flush=True)
sys.stdin.readline()
"""


def test_a_second_claim_names_the_process_that_has_the_first():
    own = os.getpid()
    with claim(ROBOT, "/worm", DOMAIN):
        assert {holder(ROBOT, "/worm", DOMAIN) for _ in range(1000)} == {own}  # as a start does
        with pytest.raises(ClaimedError, match=f"process {own}"):
            claim(ROBOT, "worm", DOMAIN)  # with or without the leading slash


@pytest.mark.parametrize(
    ("role", "namespace", "domain"),
    [(DRIVER, "/worm", DOMAIN), (ROBOT, "/worm2", DOMAIN), (ROBOT, "/worm", DOMAIN + 1)],
    ids=["role", "namespace", "domain"],
)
def test_what_differs_is_claimed_independently(role, namespace, domain):
    with claim(ROBOT, "/worm", DOMAIN), claim(role, namespace, domain):
        pass


def test_of_many_processes_that_claim_at_once_one_gets_it_and_a_kill_leaves_nothing_behind():
    command, pipe = [sys.executable, "-c", CLAIMANT, str(DOMAIN)], subprocess.PIPE
    processes = [subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) for _ in range(8)]
    try:
        for process in processes:
            process.stdin.write("go\n")
            process.stdin.flush()
        answers = {process.stdout.readline().strip(): process for process in processes}
        assert set(answers) == {"claimed", "rejected"}
        with pytest.raises(ClaimedError, match=f"process {answers['claimed'].pid}"):
            claim(ROBOT, "/worm", DOMAIN)
        answers["claimed"].kill()
        answers["claimed"].wait()
        claim(ROBOT, "/worm", DOMAIN).close()
    finally:
        for process in processes:
            process.kill()
            process.communicate()


def test_it_is_exact_after_more_attempts_than_the_kernel_keeps():
    with claim(DRIVER, "/worm", DOMAIN):
        for _ in range(300):
            with pytest.raises(ClaimedError):
                claim(DRIVER, "/worm", DOMAIN)


def test_a_virtual_robot_does_not_start_where_a_driver_runs_and_leaves_no_claim_then():
    with claim(DRIVER, "/worm", DOMAIN), pytest.raises(ClaimedError, match="a driver already"):
        claim_robot("/worm", DOMAIN)
    with claim_robot("/worm", DOMAIN), claim(DRIVER, "/worm", DOMAIN):
        pass  # the driver of this robot


def test_a_long_namespace_fits():
    name = "/".join(["", *["segment" * 4] * 8])
    with claim(DRIVER, name, DOMAIN), pytest.raises(ClaimedError):
        claim(DRIVER, name, DOMAIN)


@pytest.mark.parametrize(
    ("text", "domain"), [("", 0), ("7", 7), ("seven", 0), ("0x5", 5), ("010", 8)]
)
def test_the_domain_of_an_environment(text, domain):
    assert domain_of({"ROS_DOMAIN_ID": text}) == domain
    assert domain_of({}) == 0
