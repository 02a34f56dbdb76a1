"""A calibration over kernel CAN inside User-Mode Linux: operator and controller, witnessed by candump."""

import json
import sys

import pytest

from tests.oracles.guest_linux import in_user_mode_linux

# The poses are solved after the run: beside a bus that has priority on the only processor, solving takes minutes.
SCRIPT = """
cd /run
chrt -f 90 candump -r 8000000 -L vcan0 > dump.log &
"$0" -m operator_app.cli controller -i socketcan -c vcan0 2> controller.err &
controller=$!
until grep -q Ctrl-C controller.err; do sleep 0.2; done
"$0" -m operator_app.cli run hinge -i socketcan -c vcan0 --poses 3 --record 2> run.err &
run=$!
until ls sessions/*/poses.csv || ! kill -0 $run; do sleep 0.2; done
kill -INT $run
wait $run
echo "CODE $?"
cat run.err
kill -INT $controller
wait $controller
"$0" -m can.logconvert sessions/*/bus.blf own.log
for log in dump own; do
  for id in 080 181 187 201 610 590; do echo "FRAMES $log" $(cut -d' ' -f3 $log.log | grep "^$id#"); done
done
"$0" -m operator_app.cli solve sessions/*/poses.csv --json > out.json
echo "SOLVE $?"
echo "JSON $(tr -d '\\n' < out.json)"
"""


@pytest.mark.campaign
@pytest.mark.needs("linux.uml", "candump", "ip")
def test_record_of_a_session_on_vcan0_has_the_frames_that_candump_saw():
    out = in_user_mode_linux("bash", "-c", SCRIPT, sys.executable, patience_s=500.0)
    assert "CODE 130" in out, out[-3000:]
    rows = [line.split()[1:] for line in out.splitlines() if line.startswith("FRAMES")]
    recorded = {frames[0][:3]: frames for log, *frames in rows if log == "own"}
    seen = {frames[0][:3]: frames for log, *frames in rows if log == "dump"}
    assert set(recorded) == {"080", "181", "187", "201", "610", "590"}
    for identifier, frames in recorded.items():
        # A last answer may come after the end of the record.
        assert frames == seen[identifier][: len(frames)]
        assert len(seen[identifier]) - len(frames) <= 1
    # From joint 7's first answer on, it answers every SYNC.
    assert 0.99 * len(seen["080"]) <= len(seen["187"]) <= len(seen["080"])
    assert len(seen["080"]) > 300
    # Three poses may be too few for acceptance.
    assert "SOLVE 0" in out or "SOLVE 4" in out, out[-3000:]
    result = json.loads(out.split("JSON ")[1].splitlines()[0])
    assert (result["poses"], result["rank"]) == (3, 14)
