# SPDX-License-Identifier: Apache-2.0
"""The console in a real browser, with the virtual robot's whole graph behind it."""

import os
import re
import shutil
import signal
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
from harness import Processes

from worm_model.parameters import ParameterFile, Parameters, write_parameter_file
from worm_optimizer.operation.processes import executable_command

NEEDED = "needs pip install -r requirements-console.txt -r requirements-dev.txt"
pytest.importorskip("nicegui", reason=NEEDED)
sync_api = pytest.importorskip("playwright.sync_api", reason=NEEDED)
axe_playwright = pytest.importorskip("axe_playwright_python.sync_playwright", reason=NEEDED)
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium: apt install chromium"),
    pytest.mark.timeout(3600),
]
ARGUMENTS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run "
    "--disable-background-networking --disable-component-update --disable-sync"
).split()
TIMEOUT_S = 600.0  # includes the compilation of a kernel and a report, both with low priority on a busy machine
PASSWORD = "dirty hands"
BAGS = Path(__file__).parents[2] / "bags"
LARGEST_SHIFT = 0.1  # sum over all pages; a page counts as stable below it (web.dev/cls)
OBSERVE_SHIFTS = """
window.shifts = {sum: 0, observed: PerformanceObserver.supportedEntryTypes.includes("layout-shift")};
new PerformanceObserver((list) => list.getEntries().forEach((shift) => shifts.sum += shift.value))
  .observe({type: "layout-shift", buffered: true});
"""
HEAVIER = Parameters(rear_mass=0.45)


@pytest.fixture(scope="module")
def browser() -> Iterator["sync_api.Browser"]:
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield browser
        browser.close()


@pytest.fixture
def page(browser: "sync_api.Browser") -> Iterator["sync_api.Page"]:
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    context.set_default_timeout(1e3 * TIMEOUT_S)
    page = context.new_page()
    sync_api.expect.set_options(timeout=1e3 * TIMEOUT_S)
    yield page
    context.close()


def free_port() -> int:
    with socket.socket() as tried:
        tried.bind(("127.0.0.1", 0))
        return tried.getsockname()[1]


class Console:
    """The command as a process."""

    def __init__(self, processes: Processes, folder: Path, *arguments: str) -> None:
        self.bags = folder / "bags"
        port = free_port()
        self.address = f"http://127.0.0.1:{port}/"
        options = ["--port", str(port), "--bags", str(self.bags), *arguments]
        options += ["--control-timeout", str(TIMEOUT_S)]  # a page on a busy machine keeps control
        command = executable_command("worm_optimizer", "console")
        command = [
            "env",
            "-u",
            "PYTEST_CURRENT_TEST",
            *command,
            *options,
        ]  # otherwise NiceGUI tests itself
        self.process = processes.start(f"console_{port}", command)
        self.process.wait_for_line(re.escape(self.address), TIMEOUT_S)

    def open(self, page: "sync_api.Page") -> None:
        """Open the tab Act; the server may not listen yet."""
        for _ in range(100):
            try:
                page.goto(self.address)
                break
            except sync_api.Error:
                assert self.process.exit_code is None, self.process.output()
                page.wait_for_timeout(200)
        page.get_by_role("tab", name="Act").click()


@pytest.fixture
def console(processes: Processes, tmp_path: Path) -> Console:
    return Console(processes, tmp_path, "--virtual", "--set", f"directory={tmp_path / 'robot'}")


def press(page: "sync_api.Page", name: str) -> None:
    page.get_by_role("button", name=name, exact=True).click()


def state(page: "sync_api.Page") -> "sync_api.Locator":
    return page.get_by_role("banner").get_by_role("status")


def status(page: "sync_api.Page") -> "sync_api.Locator":
    """Return the label of the footer with the present command or the latest message."""
    return page.get_by_role("contentinfo").get_by_role("status")


def choose_a_gait(page: "sync_api.Page") -> None:
    """Take control, activate the driver, and choose a gait of the front."""
    expect = sync_api.expect
    expect(page.get_by_role("button", name="Home")).to_be_disabled()
    press(page, "Take control")
    expect(page.get_by_role("button", name="Release control")).to_be_visible()
    press(page, "Activate")
    expect(state(page)).to_have_text("idle")
    expect(page.get_by_role("button", name="Run", exact=True)).to_be_disabled()
    page.get_by_role("button", name="Read front").click()
    points = page.locator('.front svg path[fill="#0072B2"]')
    expect(points.first).to_be_visible()
    points.last.click()  # the others are partly below their neighbours
    page.get_by_label("How many").fill("1000")  # a busy browser shows the run before its end
    expect(page.get_by_role("button", name="Run", exact=True)).to_be_enabled()


def test_a_gait_is_run_stopped_found_and_reported(page: "sync_api.Page", console: Console):
    expect = sync_api.expect
    console.open(page)
    choose_a_gait(page)
    press(page, "Run")
    expect(status(page)).to_contain_text(re.compile(r"cycle ([2-9]|\d\d)"))
    page.get_by_role("tab", name="Live").click()
    expect(page.get_by_role("img", name=re.compile("robot seen"))).to_be_visible()
    page.keyboard.press("Escape")
    expect(state(page)).to_have_text("stopped, holding")
    expect(status(page)).to_contain_text("recorded in run_")
    expect(state(page)).to_have_text("stopped, holding")
    page.get_by_role("tab", name="Act").click()
    press(page, "Deactivate")
    expect(state(page)).to_have_text("inactive, torque off")
    page.get_by_role("tab", name="Recordings").click()
    row = page.get_by_role("row", name=re.compile("run_"))
    row.get_by_role("checkbox").click()
    page.get_by_role("textbox", name="Search").fill("no such run")
    expect(row.get_by_role("checkbox")).to_be_checked()
    page.get_by_role("button", name="Open report").click()
    report = page.frame_locator('iframe[title="Report"]')
    expect(report.get_by_role("heading").first).to_contain_text("Worm robot")
    press(page, "Back to the list")
    with page.expect_download() as download:
        page.get_by_role("button", name="Download").click()
    assert download.value.suggested_filename == f"{next(console.bags.glob('run_*[0-9]')).name}.zip"
    row.get_by_role("checkbox").click()
    page.get_by_role("textbox", name="Search").fill("no such run either")
    expect(row).to_have_count(0)
    console.process.interrupt()
    assert console.process.wait(TIMEOUT_S) == 0


def test_one_page_of_two_consoles_has_control_and_its_end_ends_the_run(
    page: "sync_api.Page",
    browser: "sync_api.Browser",
    console: Console,
    processes: Processes,
    tmp_path: Path,
):
    expect = sync_api.expect
    console.open(page)
    choose_a_gait(page)
    second = Console(processes, tmp_path / "second")
    context = browser.new_context()
    context.set_default_timeout(1e3 * TIMEOUT_S)
    other = context.new_page()
    second.open(other)
    expect(other.get_by_text(re.compile("^Control: a page of "))).to_be_visible()
    press(other, "Ask for control")
    press(page, "Hand over")
    expect(other.get_by_role("button", name="Release control")).to_be_visible()
    expect(page.get_by_role("button", name="Run", exact=True)).to_be_disabled()
    press(page, "Ask for control")
    press(other, "Hand over")
    expect(page.get_by_role("button", name="Release control")).to_be_visible()
    press(page, "Run")
    expect(state(other)).to_contain_text("running")
    expect(other.get_by_role("button", name="STOP")).to_be_enabled()
    page.close()
    expect(state(other)).to_have_text("idle")
    expect(other.get_by_role("button", name="Take control")).to_be_enabled()
    context.close()


def test_a_page_without_connection_shows_it_and_comes_back_without_control(
    page: "sync_api.Page", console: Console
):
    expect = sync_api.expect
    console.open(page)
    expect(state(page)).to_have_text("inactive, torque off")
    press(page, "Take control")
    expect(page.get_by_role("button", name="Release control")).to_be_visible()
    page.context.set_offline(True)
    page.evaluate("window.socket.io.engine.close()")
    connection = page.locator("#connection")
    expect(connection).to_contain_text("no connection")
    expect(page.locator("main")).to_have_attribute("inert", "")
    expect(page.get_by_text("This page has control")).to_be_hidden()
    press(page, "STOP (Esc)")
    expect(connection).to_contain_text("CANNOT BE DELIVERED")
    page.context.set_offline(False)
    expect(connection).to_be_empty()
    expect(page.get_by_role("button", name="Take control")).to_be_visible()
    expect(page.get_by_text(re.compile("lost control: Take control")).first).to_be_visible()


def test_two_runs_are_compared(page: "sync_api.Page", processes: Processes, tmp_path: Path):
    expect = sync_api.expect
    console = Console(processes, tmp_path)
    for name in ("forward", "reverse"):
        shutil.copytree(BAGS / name, console.bags / name)
    console.open(page)
    page.get_by_role("tab", name="Recordings").click()
    press(page, "Compare two")
    expect(page.get_by_text("select two bags in the list")).to_be_visible()
    for name in ("forward", "reverse"):
        page.get_by_role("row", name=name).get_by_role("checkbox").click()
    press(page, "Compare two")
    report = page.frame_locator('iframe[title="Report"]')
    for name in ("forward", "reverse"):
        expect(report.get_by_role("heading").first).to_contain_text(name)
    expect(report.get_by_role("heading", name="All runs")).to_be_visible()
    press(page, "Back to the list")
    press(page, "Look closer")
    pictures = page.get_by_role("img", name=re.compile("^Twin from"))
    expect(pictures).to_have_count(2)
    before = pictures.first.get_attribute("aria-label")
    slider = page.get_by_role("slider", name="Time since the onset, s")
    slider.press("PageUp")
    expect(pictures.first).not_to_have_attribute("aria-label", before)


def test_no_tab_violates_the_rules_of_accessibility(
    page: "sync_api.Page", processes: Processes, tmp_path: Path
):
    expect = sync_api.expect
    console = Console(processes, tmp_path)
    shutil.copytree(BAGS / "forward", console.bags / "forward")
    console.open(page)
    page.add_style_tag(content="* { transition: none !important; animation: none !important }")
    axe = axe_playwright.Axe()

    def violations() -> list[str]:
        found = axe.run(page).response["violations"]
        return [f"{rule['id']}: {node['html']}" for rule in found for node in rule["nodes"]]

    for _ in ("light", "dark"):
        page.get_by_role("tab", name="Live").click()
        expect(page.get_by_role("heading", name="Live")).to_be_visible()
        assert violations() == []
        page.get_by_role("tab", name="Act").click()
        expect(page.get_by_role("heading", name="Act", exact=True)).to_be_visible()
        assert violations() == []
        page.get_by_role("tab", name="Studies").click()
        expect(page.get_by_role("heading", name="Studies")).to_be_visible()
        assert violations() == []
        page.get_by_role("tab", name="Recordings").click()
        box = page.get_by_role("checkbox", name="Select forward")
        if not box.is_checked():
            box.click()
        assert violations() == []
        press(page, "Look closer")
        expect(page.get_by_role("slider", name="Time since the onset, s")).to_be_visible()
        assert violations() == []
        press(page, "Back to the list")
        press(page, "Light or dark")


def test_no_tab_shifts_what_a_person_looks_at(
    page: "sync_api.Page", processes: Processes, tmp_path: Path
):
    """Shifts after a click count, too, although the browser's own sum excludes them."""
    expect = sync_api.expect
    console = Console(processes, tmp_path)
    shutil.copytree(BAGS / "forward", console.bags / "forward")
    page.add_init_script(OBSERVE_SHIFTS)
    console.open(page)
    page.get_by_role("tab", name="Recordings").click()
    page.get_by_role("checkbox", name="Select forward").click()
    press(page, "Look closer")
    expect(page.get_by_role("slider", name="Time since the onset, s")).to_be_visible()
    press(page, "Back to the list")
    for name in ("Studies", "Live", "Act", "Recordings"):
        page.get_by_role("tab", name=name).click()
        expect(page.get_by_role("heading", name=name, exact=True)).to_be_visible()
    press(page, "Light or dark")
    assert page.evaluate("shifts.observed")
    assert page.evaluate("shifts.sum") < LARGEST_SHIFT


@pytest.mark.parametrize(
    ("line", "signals"),
    [
        ("Ctrl-C ends it", [signal.SIGTERM]),
        ("starting virtual_robot", [signal.SIGINT, signal.SIGINT]),
        ("starting driver", [signal.SIGINT]),
        ("all nodes run$", [signal.SIGINT, signal.SIGTERM]),
    ],
)
def test_a_signal_at_any_moment_ends_it_and_all_that_it_started(
    console: Console, line: str, signals: list[signal.Signals], tmp_path: Path
):
    console.process.wait_for_line(line, TIMEOUT_S)
    for number in signals:
        console.process.signal(number)
    assert console.process.wait(TIMEOUT_S) == 0
    assert "Traceback" not in console.process.output()
    place = os.fsencode(tmp_path / "robot")
    commands = [path.read_bytes() for path in Path("/proc").glob("[0-9]*/cmdline")]
    assert not any(place in command for command in commands)


def test_gaits_are_searched_and_parameters_identified_in_the_background(
    page: "sync_api.Page", console: Console
):
    expect = sync_api.expect
    shutil.copytree(BAGS / "forward", console.bags / "forward")
    write_parameter_file(console.bags / "identified_0.yaml", ParameterFile(HEAVIER))
    console.open(page)
    page.get_by_role("tab", name="Studies").click()
    scan = page.get_by_role("button", name="Scan margins")
    expect(scan).to_be_disabled()
    expect(
        page.get_by_text("Searches and parameters: this page does not have control")
    ).to_be_visible()
    expect(status(page)).to_contain_text("all nodes run")
    press(page, "Take control")
    expect(scan).to_be_enabled()
    press(page, "Scan margins")
    expect(status(page)).to_have_text("margin scan: the cliff is at 3.42 mm")
    page.get_by_label("Margin, mm").fill("2.5")
    press(page, "Compute front")
    expect(status(page)).to_have_text("optimisation: margin 2.50 mm, given")
    page.get_by_role("tab", name="Recordings").click()
    page.get_by_role("row", name="forward").get_by_role("checkbox").click()
    page.get_by_role("tab", name="Studies").click()
    press(page, "Identify")
    expect(page.get_by_text(re.compile("identification, .*%"))).to_be_visible()
    press(page, "Cancel identification")
    expect(status(page)).to_have_text("identification: cancelled")
    page.get_by_role("combobox", name="Parameters").click()
    page.get_by_role("option", name="identified_0.yaml").click()
    press(page, "Use")
    press(page, "Yes, use them")
    expect(page.get_by_text("In use: identified_0.yaml")).to_be_visible()


def test_a_wrong_password_is_rejected(page: "sync_api.Page", processes: Processes, tmp_path: Path):
    expect = sync_api.expect
    password = tmp_path / "password"
    password.write_text(f"{PASSWORD}\n")
    console = Console(processes, tmp_path, "--password-file", str(password))
    for _ in range(100):
        try:
            page.goto(console.address)
            break
        except sync_api.Error:
            page.wait_for_timeout(200)
    secret = page.get_by_label("Token or password")
    secret.fill("clean hands")
    press(page, "Sign in")
    expect(page.get_by_role("alert")).to_contain_text("Wrong token or password")
    assert page.goto(f"{console.address}bags/x").url.endswith("/login")
    secret.fill(PASSWORD)
    press(page, "Sign in")
    expect(state(page)).to_have_text("no driver")
    expect(page.get_by_role("button", name="STOP")).to_be_enabled()
    assert page.goto(f"{console.address}bags/..%2f..%2fpassword").status == 404
    assert os.fspath(console.bags) not in page.goto(f"{console.address}reports/none").text()
