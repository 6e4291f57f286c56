"""Ask a running system for the best action, with eclipse-zenoh and msgpack only.

    frugal up                                                    # in one terminal
    python examples/query_from_robot.py [examples/scenes/x.npz]  # in another

A robot would take the arrays from its depth camera; here they come from a case file. The messages are described in
proto_schemas/README.md. Exit code 0: the best action is on standard output, x and y in metres.
"""

import ast
import json
import os
import struct
import sys
import uuid
import zipfile
from pathlib import Path

import msgpack
import zenoh

PREFIX = "frugal/@v1/plating"
ENDPOINT = os.environ.get("FRUGAL_CONNECT", "tcp/127.0.0.1:7447")
TIMEOUT_S = 300.0


def ask(request: dict) -> dict:
    """Send an OptimizeRequest and return the OptimizeReply as a map, or leave with the reason why there is none."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps(ENDPOINT.split(",")))
    with zenoh.open(config) as session:
        try:
            replies = session.get(
                f"{PREFIX}/optimize",
                payload=msgpack.packb(request),
                encoding=zenoh.Encoding("application/msgpack").with_schema("OptimizeRequest"),
                attachment=str(TIMEOUT_S),
                timeout=TIMEOUT_S,
            )
            for reply in replies:
                if reply.ok is not None:
                    return msgpack.unpackb(reply.ok.payload.to_bytes())
                if str(reply.err.encoding) == "zenoh/string":
                    sys.exit(f"no answer: {reply.err.payload.to_string()}")
                sys.exit("refused: {code}: {message}".format(**msgpack.unpackb(reply.err.payload.to_bytes())))
        except KeyboardInterrupt:
            session.get(f"{PREFIX}/orchestrator/*/cancel/{request['id']}", timeout=1.0)
            sys.exit("interrupted; the orchestrator was told")
    sys.exit(f"no reply: nobody serves {PREFIX}/optimize")


def main() -> None:
    """Send the request, print the answer."""
    default = Path(__file__).parent / "scenes" / "01-steak-heap.npz"
    answer = ask(make_request(Path(sys.argv[1]) if len(sys.argv) > 1 else default))
    print(f"{answer['action'][0]:.6f} {answer['action'][1]:.6f}")
    print(f"mean height error {-answer['reward'] * 1e3:.3f} mm, models used: {answer['usage']}", file=sys.stderr)


def make_request(path: Path) -> dict:
    """Return an OptimizeRequest for a case file."""
    arrays = read_arrays(path)
    rows, columns = arrays["scene_heights"]["shape"]
    scene = {"heights": arrays["scene_heights"], "materials": arrays["scene_materials"], "bodies": known_bodies(arrays)}
    item = {"heights": arrays["item_heights"], "materials": arrays["item_materials"]}
    grid = {"rows": rows, "columns": columns, "cell": cell_size(arrays)}
    return {
        "state": {"grid": grid, "scene": scene, "item": item},
        "target": arrays["target"],
        "seed": 0,
        "id": uuid.uuid4().hex,
    }


def read_arrays(path: Path) -> dict[str, dict]:
    """Return every array of an .npz file as {dtype, shape, data}, the format of arrays on the wire."""
    arrays = {}
    with zipfile.ZipFile(path) as archive:
        for name in archive.namelist():
            content = archive.read(name)
            (length,) = struct.unpack_from("<H", content, 8)
            header = ast.literal_eval(content[10 : 10 + length].decode("latin1"))
            dtype = {"<f4": "float32", "<f8": "float64"}.get(header["descr"], header["descr"])
            arrays[name.removesuffix(".npy")] = {
                "dtype": dtype,
                "shape": header["shape"],
                "data": content[10 + length :],
            }
    return arrays


def numbers(array: dict) -> list[float]:
    """Return the elements of a float64 array."""
    return list(struct.unpack(f"<{len(array['data']) // 8}d", array["data"]))


def cell_size(arrays: dict[str, dict]) -> float:
    """Return the edge of a cell, which stands in the JSON text that a case file begins with [m]."""
    return json.loads(arrays["about"]["data"].decode("utf-32-le"))["cell"]


def known_bodies(arrays: dict[str, dict]) -> dict | None:
    """Return plate and fries where the file knows them; without them the simulator finds them in the heightmap."""
    if "boxes" not in arrays:
        return None
    plate, boxes = None, []
    if "plate" in arrays:
        profile = numbers(arrays["plate"])
        plate = {"radii": profile[: len(profile) // 2], "heights": profile[len(profile) // 2 :]}
    for start in range(0, len(values := numbers(arrays["boxes"])), 13):
        box = values[start : start + 13]
        material = dict(zip(("density", "youngs_modulus", "poisson_ratio"), box[10:], strict=True))
        boxes.append({"size": box[:3], "position": box[3:6], "orientation": box[6:10], **material})
    return {"plate": plate, "boxes": boxes}


if __name__ == "__main__":
    main()
