"""Make 42 models for `odt-plugins batch` from MeshLab's samples, two of them poisoned.

python examples/batch_models.py models
odt-plugins batch 'models/*.stl' 'models/*.ply' --out results --workers 2 --timeout 60

makes surfaces that are optimised as such; coarser ones that TetWild fills in seconds, and one that
it cannot fill:

python examples/batch_models.py solids --tetrahedralize
odt-plugins batch 'solids/*' --out tets --tetrahedralize --edge-length 0.1 --workers 2 --timeout 60
"""

import sys
from pathlib import Path

import pymeshlab

SURFACES = ("bone.ply", "cow.obj", "bunny10k_textured.obj", "cube.obj")
LENGTHS = (1.0, 1.2, 1.4, 1.6, 1.8, 2.0, 2.3, 2.6, 3.0, 3.5)
"""Edge lengths, in per cent of the diagonal of the bounding box."""

SOLIDS = ("bone.ply", "cow.obj", "bunny.obj", "airplane.obj")
COARSE = (4.0, 4.5, 5.0, 5.5, 6.0, 7.0, 8.0, 9.0, 10.0, 12.0)


def make_models(folder: Path, samples=SURFACES, lengths=LENGTHS, solid=False) -> int:
    """Write every sample with every edge length, and two files that are poisoned; how many."""
    folder.mkdir(parents=True, exist_ok=True)
    place = Path(pymeshlab.__file__).parent / "tests" / "sample_meshes"
    more = {"iterations": 10, "featuredeg": 60} if solid else {"iterations": 3}
    for sample in samples:
        for length in lengths:
            meshes = pymeshlab.MeshSet()
            meshes.load_new_mesh(str(place / sample))
            meshes.meshing_isotropic_explicit_remeshing(
                targetlen=pymeshlab.PercentageValue(length), **more)
            name = f"{Path(sample).stem}-{round(10 * length)}.stl"
            meshes.save_current_mesh(str(folder / name))
    # A reader never comes back from this one.
    (folder / "poisoned.ply").write_text("ply\nformat ascii 1.0\nelement vertex 3\n")
    if solid:
        meshes = pymeshlab.MeshSet()
        meshes.create_grid(numvertx=9, numverty=9)
        meshes.save_current_mesh(str(folder / "poisoned.stl"))
    else:
        (folder / "poisoned.stl").write_bytes(b"\x00" * 84)
    return len([*folder.glob("*.stl"), *folder.glob("*.ply")])


if __name__ == "__main__":
    solid = "--tetrahedralize" in sys.argv
    words = [word for word in sys.argv[1:] if word != "--tetrahedralize"]
    kind = (SOLIDS, COARSE) if solid else (SURFACES, LENGTHS)
    print(make_models(Path(words[0] if words else "models"), *kind, solid=solid), "models")
