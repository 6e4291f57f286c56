"""``frugal data import``: trials of your own, seen by a depth camera."""

from pathlib import Path

import click

from common.domain.bodies import Material
from common.domain.errors import RequestError
from common.domain.grid import Grid
from common.domain.world import Sight
from services.cli.asking import say

FILE = click.Path(path_type=Path)
MATERIAL = (click.FLOAT, click.FLOAT, click.FLOAT)


@click.command("import")
@click.option("--depth-before", type=FILE, required=True, help="Plate and food before: 16-bit PNG or NPY.")
@click.option("--depth-after", type=FILE, required=True, help="The same with the item placed.")
@click.option("--depth-item", type=FILE, required=True, help="The item alone on the flat of the empty plate.")
@click.option("--depth-plate", type=FILE, help="The empty plate; without it, the default one.")
@click.option("--intrinsics", type=FILE, required=True, help="JSON with fx, fy, cx, cy [pixel].")
@click.option("--pose", type=FILE, required=True, help="JSON, 4 x 4 matrix from the camera's to the plate's frame [m].")
@click.option(
    "--depth-scale",
    type=click.FloatRange(0, min_open=True),
    default=0.001,
    show_default=True,
    help="What one unit of a whole number means [m]; floating point numbers are metres.",
)
@click.option(
    "--item-material", type=MATERIAL, required=True, help="Density [kg/m3], Young's modulus [Pa], Poisson's ratio."
)
@click.option(
    "--scene-material", type=MATERIAL, default=(550.0, 1e6, 0.3), show_default=True, help="The same of what lies there."
)
@click.option("--action", type=(click.FLOAT, click.FLOAT), help="Where the item's centre was placed, x and y [m].")
@click.option("--rows", type=int, default=96, show_default=True, help="Cells of the heightmaps along y.")
@click.option("--columns", type=int, default=96, show_default=True, help="Cells of the heightmaps along x.")
@click.option("--cell", type=float, default=0.003, show_default=True, help="Edge of a cell [m].")
@click.option("--out", type=FILE, required=True, help="The case file, .npz.")
def import_depth(
    *,
    depth_before: Path,
    depth_after: Path,
    depth_item: Path,
    depth_plate: Path | None,
    intrinsics: Path,
    pose: Path,
    depth_scale: float,
    item_material: tuple[float, float, float],
    scene_material: tuple[float, float, float],
    action: tuple[float, float] | None,
    rows: int,
    columns: int,
    cell: float,
    out: Path,
) -> None:
    """Turn depth images of a trial into a case: scene, item, action and the scene after as the target."""
    from common.storage.cases import write_case
    from pipelines.data.depth_case import make_case
    from pipelines.data.depth_files import read_camera, read_depth

    if out.suffix != ".npz":
        raise RequestError(f"--out: expected a file .npz, got {out}")
    grid, camera = Grid(rows, columns, cell), read_camera(intrinsics, pose)

    def read(path: Path):
        return read_depth(path, scale=depth_scale)

    sight = Sight(
        before=read(depth_before),
        item=read(depth_item),
        plate=None if depth_plate is None else read(depth_plate),
        camera=camera,
        item_material=Material(*item_material),
        scene_material=Material(*scene_material),
    )
    case = make_case(out.stem, sight, read(depth_after), action, grid=grid)
    write_case(out, case)
    item = case.state.item
    area = float(item.outline.sum()) * cell**2
    say(
        f"{out}: item of {1e4 * area:.0f} cm2, {1e3 * float(item.heights.max()):.1f} mm thick; food on "
        f"{int((case.state.scene.materials[0] > 0).sum())} cells of the scene"
    )
