import numpy as np
from numpy.typing import NDArray

def build(
    lower: NDArray[np.float32], upper: NDArray[np.float32], packet: int = 8, threads: int = 0
) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.int32], int]:
    """A bounding volume hierarchy, eight children wide, over boxes.

    Takes the boxes' corners `lower` and `upper`, each (n, 3), the number of primitives that are tested together,
    `packet` (1 to 64), and the number of threads (0: one for each processor), on which the result does not depend.

    Returns `(bounds, children, order, depth)`:

    - `bounds`, (nodes, 6, 8) float32: lower x, y, z and upper x, y, z of the eight children of each node; lower is
      +inf and upper -inf where a slot is empty.
    - `children`, (nodes, 8) int32: the number of an inner node if not negative; -2147483648 for an empty slot; else
      a leaf, -1 - (8 * first + count - 1), of the `count` packets (1 to 8) from packet number `first` on. Node 0 is
      the root, and children come after their parents, depth first.
    - `order`, (m,) int32: the primitives in the order of the leaves, a multiple of `packet` of them: each leaf is
      filled up with -1.
    - `depth`: the most nodes on a path from the root, at most 77 whatever the boxes; a traversal's stack needs at most
      7 * depth + 1 entries.

    Raises ValueError where a shape is another, there is no box or more than 2^28 - 1, a box has a corner that is not
    finite or lower > upper (the first such box is named), or packet or threads are out of range.

    Splits by the surface area heuristic over bins (Wald 2007, doi:10.1109/RT.2007.4342588), collapsed to eight
    children and leaves of whole packets at the least cost (Ylitie et al. 2017, doi:10.1145/3105762.3105773).
    """
