"""Report an executed action to a running recorder, with eclipse-zenoh and msgpack only.

    frugal up                                                           # in one terminal
    python examples/report_trial.py [ROBOT [examples/scenes/x.npz]]     # in another

A robot would take scene, item and outcome from its depth camera and the action from its own joints; here a case file
has all of them. The messages are described in proto_schemas/README.md. Exit code 0: the trial is on the recorder's
disk, and its number and file are on standard output.
"""

import json
import sys
import time
from pathlib import Path

import msgpack
import zenoh
from query_from_robot import ENDPOINT, PREFIX, make_request, read_arrays

ATTEMPTS = 5
TIMEOUT_S = 10.0


def report(trial: dict, *, robot: str) -> dict:
    """Send a TrialReport and return the TrialReply as a map, or leave with the reason why it was refused.

    Where no answer comes, the trial may be recorded all the same: it is sent again with the same id, which gets the
    same answer and is recorded once.
    """
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps(ENDPOINT.split(",")))
    with zenoh.open(config) as session:
        for attempt in range(ATTEMPTS):
            time.sleep(attempt)
            replies = session.get(
                f"{PREFIX}/trial/{robot}",
                payload=msgpack.packb(trial),
                encoding=zenoh.Encoding("application/msgpack").with_schema("TrialReport"),
                attachment=str(TIMEOUT_S),
                timeout=TIMEOUT_S,
            )
            for reply in replies:
                if reply.ok is not None:
                    return msgpack.unpackb(reply.ok.payload.to_bytes())
                if str(reply.err.encoding) == "zenoh/string":
                    continue  # a timeout
                error = msgpack.unpackb(reply.err.payload.to_bytes())
                if error["code"] == "request":
                    sys.exit("refused: {message}".format(**error))
    sys.exit(f"not acknowledged in {ATTEMPTS} attempts: is there a recorder at {PREFIX}/trial/{robot}?")


def make_report(path: Path) -> dict:
    """Return a TrialReport for a case file whose target is the outcome of its action."""
    arrays, request = read_arrays(path), make_request(path)
    about = json.loads(arrays["about"]["data"].decode("utf-32-le"))
    return {
        "id": request["id"],
        "state": request["state"],
        "action": about["true_action"],
        "outcome": request["target"],
        "notes": about["notes"],
    }


def main() -> None:
    """Send the report, print the acknowledgement."""
    robot = sys.argv[1] if len(sys.argv) > 1 else "robot-1"
    default = Path(__file__).parent / "scenes" / "04-medallion-bare.npz"
    kept = report(make_report(Path(sys.argv[2]) if len(sys.argv) > 2 else default), robot=robot)
    print(f"{kept['number']} {kept['file']}")


if __name__ == "__main__":
    main()
