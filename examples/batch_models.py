"""Make 42 models for `odt-plugins batch` from MeshLab's samples, two of them poisoned.

python examples/batch_models.py models
odt-plugins batch 'models/*.stl' 'models/*.ply' --out results --workers 2
"""

import sys
from pathlib import Path

import pymeshlab

SAMPLES = ("bone.ply", "cow.obj", "bunny10k_textured.obj", "cube.obj")
LENGTHS = (1.0, 1.2, 1.4, 1.6, 1.8, 2.0, 2.3, 2.6, 3.0, 3.5)
"""Edge lengths, in per cent of the diagonal of the bounding box."""


def make_models(folder: Path, samples=SAMPLES, lengths=LENGTHS) -> int:
    """Write every sample with every edge length, and two files that are no meshes; how many."""
    folder.mkdir(parents=True, exist_ok=True)
    place = Path(pymeshlab.__file__).parent / "tests" / "sample_meshes"
    for sample in samples:
        for length in lengths:
            meshes = pymeshlab.MeshSet()
            meshes.load_new_mesh(str(place / sample))
            meshes.meshing_isotropic_explicit_remeshing(
                targetlen=pymeshlab.PercentageValue(length), iterations=3)
            name = f"{Path(sample).stem}-{round(10 * length)}.stl"
            meshes.save_current_mesh(str(folder / name))
    (folder / "poisoned.ply").write_text("ply\nformat ascii 1.0\nelement vertex 3\n")
    (folder / "poisoned.stl").write_bytes(b"\x00" * 84)
    return len([*folder.glob("*.stl"), *folder.glob("*.ply")])


if __name__ == "__main__":
    print(make_models(Path(sys.argv[1] if len(sys.argv) > 1 else "models")), "models")
