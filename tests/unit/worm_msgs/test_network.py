# SPDX-License-Identifier: Apache-2.0
"""Processes that may discover a process with ROS: the environment decides, before the middleware starts."""

import os
from pathlib import Path
from xml.etree import ElementTree

import pytest

from worm_msgs import network

FAST_DDS, CYCLONE_DDS = "rmw_fastrtps_cpp", "rmw_cyclonedds_cpp"
PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"
OPENERS = (
    {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"},
    {"ROS_STATIC_PEERS": "192.168.1.7"},
    {"ROS_STATIC_PEERS": "[2001:db8::1]:11811"},
    {"ROS_STATIC_PEERS": "localhost;robot.lan"},
    {"ROS_DISCOVERY_SERVER": "192.168.1.7:11811"},
    {PROFILE: "/home/somebody/profiles.xml"},
    {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT"},
)


@pytest.mark.parametrize("middleware", [FAST_DDS, "rmw_fastrtps_dynamic_cpp", CYCLONE_DDS])
@pytest.mark.parametrize(
    "given",
    [
        {},
        {"WORM_NETWORK": "0"},
        {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
        {"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"},
        {"ROS_STATIC_PEERS": "127.0.0.1;localhost;::1"},
        {"ROS_DISCOVERY_SERVER": "127.0.0.1:11811;[::1]:11811"},
    ],
)
def test_without_a_decision_it_stays_on_the_machine(middleware, given):
    environment = dict(given)
    assert network.bind(environment, middleware).is_local
    assert set(environment) > set(given)
    assert PROFILE in environment or "CYCLONEDDS_URI" in environment
    range_ = environment["ROS_AUTOMATIC_DISCOVERY_RANGE"]
    assert range_ != "SUBNET"
    assert (range_ == "OFF") == ("OFF" in given.values())
    inherited = dict(environment)  # by a started process
    assert network.bind(environment, middleware).is_local
    assert environment == inherited


@pytest.mark.parametrize("given", [{"WORM_NETWORK": "1"}, *OPENERS])
def test_a_decision_for_the_network_is_kept_and_reported_by_its_name(given):
    environment = dict(given)
    reach = network.bind(environment, FAST_DDS)
    ((name, value),) = given.items()
    assert not reach.is_local
    assert f"{name}={value}" in str(reach)
    assert "can move the robot" in str(reach)
    assert environment.get(PROFILE) == given.get(PROFILE)
    assert environment[name] == value


@pytest.mark.parametrize("given", OPENERS)
def test_a_decision_against_the_network_has_priority(given):
    environment = {"WORM_NETWORK": "0", **given}
    assert network.bind(environment, FAST_DDS).is_local
    assert environment[PROFILE].endswith("fastdds_loopback.xml")
    assert environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] != "SUBNET"


def test_the_decision_takes_an_inherited_binding_back():
    environment: dict[str, str] = {}
    network.bind(environment, FAST_DDS)
    environment["WORM_NETWORK"] = "1"
    assert not network.bind(environment, FAST_DDS).is_local
    assert PROFILE not in environment
    assert environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SUBNET"


def test_a_middleware_that_cannot_be_kept_here_needs_a_decision():
    with pytest.raises(network.NetworkError, match=r"rmw_zenoh_cpp.*WORM_NETWORK=1"):
        network.bind({}, "rmw_zenoh_cpp")
    assert not network.bind({"WORM_NETWORK": "1"}, "rmw_zenoh_cpp").is_local


def test_what_is_set_for_each_middleware_is_well_formed_and_names_no_other_address():
    environment: dict[str, str] = {}
    network.bind(environment, FAST_DDS)
    profile = ElementTree.parse(Path(environment[PROFILE])).getroot()
    found = {e.text for e in profile.iter() if e.tag.endswith("}address")}
    assert found == {"127.0.0.1"}
    network.bind(environment, CYCLONE_DDS)
    cyclone = ElementTree.fromstring(environment["CYCLONEDDS_URI"])
    addresses = {e.get("address") for e in cyclone.iter() if e.get("address")}
    assert addresses == {"127.0.0.1"}


def test_these_tests_can_be_discovered_on_this_machine_only():
    assert network.reach(os.environ, FAST_DDS).is_local
    assert os.environ[PROFILE].endswith("fastdds_loopback.xml")


@pytest.mark.parametrize("domain", ["233", "0x100", "-1"])
def test_a_domain_that_the_middleware_cannot_use_is_rejected(domain: str):
    with pytest.raises(network.NetworkError, match="ROS_DOMAIN_ID"):
        network.bind({"ROS_DOMAIN_ID": domain}, FAST_DDS)
