"""
Structures of the library
=========================

``tc.library`` has known structures. Each is a function of its sizes. The figure shows them with
their class (the largest number of bars that share a node), states of self-stress and mechanisms.
White nodes are joints of bars, triangles are supports.
"""

import matplotlib.pyplot as plt
import numpy as np

import tenscontrol as tc

sizes = {
    "arm": {"sections": 4},
    "cable_net": {"rows": 7, "columns": 7},
    "class2_tower": {"stages": 3},
    "geiger_dome": {"sides": 8},
    "levy_dome": {"sides": 12},
    "net": {"rows": 6, "columns": 6, "spacing": 0.1, "node_mass": 0.01, "fixed": "edges"},
    "prism_tower": {"stages": 3},
    "spine": {"vertebrae": 4},
}
structures = {name: getattr(tc.library, name)(**sizes.get(name, {})) for name in tc.library.__all__}


# %%
# States of self-stress s and mechanisms m follow from the rank of the matrix that has the
# directions of all members that can move: s members more than the rank, and m coordinates, less
# the motions as one body that the supports leave.


def counts(structure):
    """Return the states of self-stress and the mechanisms of a structure."""
    members = np.vstack([structure.bars, structure.strings])
    vectors = structure.nodes[:, members[:, 1]] - structure.nodes[:, members[:, 0]]
    units = vectors / np.linalg.norm(vectors, axis=0)
    rows = np.zeros((len(members), *structure.nodes.T.shape))
    each = np.arange(len(members))
    rows[each, members[:, 0]], rows[each, members[:, 1]] = -units.T, units.T
    moves = ~np.isin(members, structure.fixed).all(axis=1)
    matrix = rows.reshape(len(members), -1)[moves][:, structure.free_rows]
    rank = np.linalg.matrix_rank(matrix, tol=1e-9 * np.linalg.norm(matrix, 2))
    bodily = tc.structure.supports.rigid_basis(structure).shape[1]
    return len(matrix) - rank, matrix.shape[1] - rank - bodily


found = {name: counts(structure) for name, structure in structures.items()}

# %%
# Those in the plane are drawn in flat axes.

figure = plt.figure(figsize=(13.0, 11.5))
for i, (name, structure) in enumerate(structures.items()):
    projection = "3d" if structure.dimension == 3 else None
    ax = figure.add_subplot(-(-len(found) // 5), 5, i + 1, projection=projection)
    tc.plot.structure(structure, ax=ax, legend=False)
    ax.set_axis_off()
    states, mechanisms = found[name]
    numbers = f"class {structure.structure_class}, s = {states}, m = {mechanisms}"
    figure.text(0.1 + 0.2 * (i % 5), 0.985 - 0.25 * (i // 5), f"{name}\n{numbers}",
                ha="center", va="top", fontsize="medium")  # fmt: skip
figure.subplots_adjust(left=0.01, right=0.99, bottom=0.01, top=0.94, wspace=0.1, hspace=0.25)
for ax in figure.axes:
    if ax.name == "3d":  # which leaves room around what it draws
        place = ax.get_position()
        ax.set_position(place.expanded(1.25, 1.25))

if __name__ == "__main__":
    plt.show()
