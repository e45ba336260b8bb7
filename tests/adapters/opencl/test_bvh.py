"""The bounding volume hierarchy holds each box once, within what its nodes say, for any boxes and number of threads.

Each check is also held against trees that it must reject.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pytest

pytestmark = pytest.mark.needs("pyopencl")

Array = npt.NDArray[Any]
Boxes = tuple[Array, Array]

EMPTY = -(2**31)
MAX_DEPTH = 77
LARGE = 50_000  # from 32769 boxes on the top of the tree is built by all threads
FMAX = float(np.finfo(np.float32).max)


class Tree(NamedTuple):
    bounds: Array
    children: Array
    order: Array
    depth: int


class Leaves(NamedTuple):
    node: Array
    slot: Array
    first: Array
    count: Array


Build = Callable[..., Tree]


@pytest.fixture(scope="session")
def build(opencl: Any) -> Build:
    from pmc_sampler.adapters.opencl import _bvh

    return lambda *args, **options: Tree(*_bvh.build(*args, **options))


def boxes(lower: Array, upper: Array | None = None) -> Boxes:
    upper = lower if upper is None else upper
    pair = np.clip(lower, -FMAX, FMAX).astype(np.float32), np.clip(upper, -FMAX, FMAX).astype(np.float32)
    return np.minimum(*pair), np.maximum(*pair)


def uniform(n: int, rng: np.random.Generator) -> Boxes:
    centre, half = rng.uniform(-5, 5, (n, 3)), rng.exponential(0.5 * n ** (-1 / 3), (n, 3))
    return boxes(centre - half, centre + half)


def clustered(n: int, rng: np.random.Generator) -> Boxes:
    centre = rng.uniform(-5, 5, (20, 3))[rng.integers(20, size=n)] + rng.normal(0, 0.05, (n, 3))
    half = rng.exponential(0.01, (n, 3))
    return boxes(centre - half, centre + half)


def equal(n: int, rng: np.random.Generator) -> Boxes:
    return boxes(np.full((n, 3), -1), np.full((n, 3), 2.5))


def equal_points(n: int, rng: np.random.Generator) -> Boxes:
    return boxes(np.full((n, 3), 0.1))


def points(n: int, rng: np.random.Generator) -> Boxes:
    return boxes(rng.normal(size=(n, 3)))


def line(n: int, rng: np.random.Generator) -> Boxes:
    return boxes(rng.random((n, 1)) * [0, 1, 0])


def oblique_line(n: int, rng: np.random.Generator) -> Boxes:
    return boxes(rng.random((n, 1)) * [1, -2, 3])


def flat(n: int, rng: np.random.Generator) -> Boxes:
    lower = rng.random((n, 3))
    return boxes(lower * [1, 1, 0] + [0, 0, 7], (lower + 0.01) * [1, 1, 0] + [0, 0, 7])


def scales(n: int, rng: np.random.Generator) -> Boxes:
    lower = rng.random((n, 3)) * np.where(np.arange(n) % 3, 1e-4, 1e6)[:, None]
    return boxes(lower, lower + 1e-6)


def giant(n: int, rng: np.random.Generator) -> Boxes:
    lower, upper = uniform(n, rng)
    lower[n // 2], upper[n // 2] = -1e9, 1e9
    return lower, upper


def nested(n: int, rng: np.random.Generator) -> Boxes:
    half = 1.001 ** np.arange(n)[:, None] * np.ones(3)
    return boxes(-half, half)


def extreme(n: int, rng: np.random.Generator) -> Boxes:
    return boxes(*rng.uniform(-FMAX, FMAX, (2, n, 3)))


def extreme_points(n: int, rng: np.random.Generator) -> Boxes:
    return boxes(rng.choice([-FMAX, FMAX], (n, 3)))


def everything(n: int, rng: np.random.Generator) -> Boxes:
    return boxes(np.full((n, 3), -FMAX), np.full((n, 3), FMAX))


def denormal(n: int, rng: np.random.Generator) -> Boxes:
    return boxes(*rng.uniform(-1e-41, 1e-41, (2, n, 3)))


def ordered(n: int, rng: np.random.Generator) -> Boxes:
    return boxes(np.arange(n)[:, None] * np.ones(3), np.arange(n)[:, None] + np.ones(3))


def octaves(n: int, rng: np.random.Generator) -> Boxes:
    """Every octave of the floats, on each axis: splits by the area alone would cut off one end at a time."""
    return boxes(np.exp2(rng.integers(-149, 128, (n, 3))) * rng.choice([-1, 1], (n, 3)))


def one_octave_each(n: int, rng: np.random.Generator) -> Boxes:
    return boxes(np.exp2(np.arange(n) % 277 - 149)[:, None] * np.ones(3))


KINDS = [
    uniform, clustered, equal, equal_points, points, line, oblique_line, flat, scales, giant, nested, extreme,
    extreme_points, everything, denormal, ordered, octaves, one_octave_each,
]  # fmt: skip
kinds = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)


def leaves_of(children: Array) -> Leaves:
    """All leaves, in the order of their packets."""
    node, slot = np.nonzero((children < 0) & (children != EMPTY))
    code = -1 - children[node, slot].astype(np.int64)
    place = np.argsort(code, kind="stable")
    return Leaves(node[place], slot[place], code[place] // 8, code[place] % 8 + 1)


def refit(children: Array, order: Array, packet: int, lower: Array, upper: Array) -> Array:
    """The bounds that belong to a tree whose packets are already known to be sound: as tight as can be."""
    nothing = np.full((1, 3), np.inf, np.float32)
    corners = np.concatenate([np.append(lower, nothing, 0), np.append(-upper, nothing, 0)], axis=1)
    packets = corners[order].reshape(-1, packet, 6).min(1)
    leaves = leaves_of(children)
    fit = np.full((*children.shape, 6), np.inf, np.float32)
    fit[leaves.node, leaves.slot] = np.minimum.reduceat(packets, leaves.first)
    for node, slot in np.argwhere(children >= 0)[::-1]:
        fit[node, slot] = fit[children[node, slot]].min(0)
    return np.swapaxes(fit * np.float32([1, 1, 1, -1, -1, -1]), 1, 2)


def walk(children: Array) -> tuple[list[int], int]:
    """The nodes depth first, and the most of them on a path."""
    seen, deepest, stack = [], 0, [(0, 1)]
    while stack:
        node, depth = stack.pop()
        assert node < len(children), "no such node"
        assert len(seen) < len(children), "a node is met twice"
        seen.append(node)
        deepest = max(deepest, depth)
        stack += [(child, depth + 1) for child in children[node][::-1].tolist() if child >= 0]
    return seen, deepest


def check(tree: Tree, lower: Array, upper: Array, packet: int) -> None:
    """Asserts all that the stub says of a tree."""
    bounds, children, order, depth = tree
    nodes, n = len(children), len(lower)
    assert (bounds.dtype, children.dtype, order.dtype) == (np.float32, np.int32, np.int32)
    assert bounds.shape == (nodes, 6, 8)
    assert children.shape == (nodes, 8)
    assert order.ndim == 1
    assert len(order) % packet == 0
    assert np.array_equal(np.sort(order[order != -1]), np.arange(n)), "every primitive exactly once"

    leaves = leaves_of(children)
    ends = leaves.first + leaves.count
    assert np.array_equal(leaves.first, np.append(0, ends[:-1])), "every packet in exactly one leaf"
    assert ends[-1] * packet == len(order)
    filled = np.add.reduceat(order != -1, leaves.first * packet)
    assert np.array_equal(-(-filled // packet), leaves.count), "no packet more than needed"
    place = np.arange(len(order)) - np.repeat(leaves.first, leaves.count * packet) * packet
    assert np.array_equal(order != -1, place < np.repeat(filled, leaves.count * packet)), "padding at a leaf's end"

    visited, deepest = walk(children)
    assert visited == list(range(nodes)), "every node once, after its parent, depth first"
    assert depth == deepest
    assert depth <= MAX_DEPTH
    used = np.sum(children != EMPTY, axis=1)
    assert (used >= (1 if nodes == 1 else 2)).all()

    hollow = np.swapaxes(bounds, 1, 2)[children == EMPTY]
    assert (hollow == [np.inf] * 3 + [-np.inf] * 3).all(), "empty slots are inverted"
    # Equal to the tightest boxes, so that each holds its primitives or its child's boxes.
    assert np.array_equal(bounds, refit(children, order, packet, lower, upper))


@kinds
@pytest.mark.parametrize("n", [1, 2, 65, 700])
@pytest.mark.parametrize("packet", [1, 3, 8, 64])
def test_sound(kind: Callable[..., Boxes], n: int, packet: int, build: Build) -> None:
    lower, upper = kind(n, np.random.default_rng(n))
    check(build(lower, upper, packet=packet), lower, upper, packet)


@kinds
def test_sound_and_equal_on_any_number_of_threads(kind: Callable[..., Boxes], build: Build) -> None:
    lower, upper = kind(LARGE, np.random.default_rng(3))
    tree = build(lower, upper, 8, 1)
    check(tree, lower, upper, 8)
    for threads in (2, 16):
        other = build(lower, upper, 8, threads)
        assert all(a.tobytes() == b.tobytes() for a, b in zip(tree[:3], other[:3], strict=True))
        assert other.depth == tree.depth


def wrong(tree: Tree, how: str, packet: int) -> Tree:
    """A copy of the tree, spoilt."""
    bounds, children, order, depth = (np.copy(part) for part in tree)
    leaves = leaves_of(children)
    inner = np.argwhere(children >= 0)
    if how == "primitive twice":
        order[0] = order[packet]
    elif how == "primitive missing":
        order[np.flatnonzero(order[packet - 1 :: packet] >= 0)[0] * packet + packet - 1] = -1
    elif how == "padding first":
        short = np.flatnonzero(order == -1)[0]
        order[[short - 1, short]] = order[[short, short - 1]]
    elif how == "leaf missing":
        children[leaves.node[4], leaves.slot[4]] = EMPTY
        bounds[leaves.node[4], :, leaves.slot[4]] = [np.inf] * 3 + [-np.inf] * 3
    elif how == "packet too many":
        children[leaves.node[4], leaves.slot[4]] -= 1
    elif how == "packet twice":
        children[leaves.node[3], leaves.slot[3]] = children[leaves.node[2], leaves.slot[2]]
    elif how == "node twice":
        children[tuple(inner[1])] = children[tuple(inner[0])]
    elif how == "cycle":
        children[tuple(inner[-1])] = 0
    elif how == "siblings exchanged":
        children[tuple(inner[[0, 1]].T)] = children[tuple(inner[[1, 0]].T)]
    elif how == "depth":
        depth = depth - 1
    elif how == "leaf's box":
        bounds[leaves.node[5], 3, leaves.slot[5]] = np.nextafter(bounds[leaves.node[5], 3, leaves.slot[5]], -FMAX)
    elif how == "node's box":
        bounds[inner[0][0], 0, inner[0][1]] = np.nextafter(bounds[inner[0][0], 0, inner[0][1]], FMAX)
    elif how == "empty slot":
        node, slot = np.argwhere(children == EMPTY)[0]
        bounds[node, :, slot] = 0
    elif how == "primitives exchanged":
        order[[0, leaves.first[-1] * packet]] = order[[leaves.first[-1] * packet, 0]]
    return Tree(bounds, children, order, int(depth))


@pytest.mark.parametrize(
    "how",
    [
        "primitive twice", "primitive missing", "padding first", "leaf missing",
        "packet too many", "packet twice", "node twice",
        "cycle", "siblings exchanged", "depth", "leaf's box", "node's box", "empty slot", "primitives exchanged",
    ],
)  # fmt: skip
def test_check_rejects(how: str, build: Build) -> None:
    packet = 3
    lower, upper = uniform(2000, np.random.default_rng(1))
    tree = build(lower, upper, packet)
    check(wrong(tree, "nothing", packet), lower, upper, packet)
    with pytest.raises(AssertionError):
        check(wrong(tree, how, packet), lower, upper, packet)


def test_single_leaves(build: Build) -> None:
    lower, upper = np.float32([[1, 2, 3]]), np.float32([[4, 5, 6]])
    bounds, children, order, depth = build(lower, upper)
    assert children.tolist() == [[-1] + [EMPTY] * 7]
    assert order.tolist() == [0] + [-1] * 7
    assert depth == 1
    assert bounds[0].tolist() == [[x] + [np.inf] * 7 for x in (1, 2, 3)] + [[x] + [-np.inf] * 7 for x in (4, 5, 6)]
    # Equal boxes are not worth a node until they fill more than eight packets.
    lower, upper = equal(65, np.random.default_rng(0))
    assert build(lower[:64], upper[:64]).children.tolist() == [[-8] + [EMPTY] * 7]
    assert np.sum(build(lower, upper).children != EMPTY) > 1


def half_surface(bounds: Array) -> Array:
    x, y, z = np.moveaxis(bounds[..., 3:].astype(np.float64) - bounds[..., :3], -1, 0)
    return x * y + y * z + z * x


def cost(bounds: Array, children: Array) -> float:
    """Nodes and packets that a ray through the root's box tests on average, by their surface."""
    box = np.swapaxes(bounds, 1, 2)
    whole = half_surface(np.append(box[0, :, :3].min(0), box[0, :, 3:].max(0)))
    leaves = leaves_of(children)
    packets = np.sum(half_surface(box[leaves.node, leaves.slot]) * leaves.count)
    return float(1 + (packets + np.sum(half_surface(box[children >= 0]))) / whole)


def median_split(lower: Array, upper: Array, packet: int) -> Tree:
    """Halves by the centres along their longest side, three times for a node, down to a packet for a leaf."""
    centre = lower.astype(np.float64) + upper
    children: list[list[int]] = []
    order: list[int] = []

    def halves(part: Array, times: int) -> list[Array]:
        if times == 0 or len(part) <= packet:
            return [part]
        axis = np.argmax(np.ptp(centre[part], axis=0))
        part = part[np.argsort(centre[part, axis], kind="stable")]
        middle = -(-(len(part) // 2) // packet) * packet
        return [*halves(part[:middle], times - 1), *halves(part[middle:], times - 1)]

    def emit(part: Array) -> int:
        node = len(children)
        children.append([EMPTY] * 8)
        for slot, piece in enumerate(halves(part, 3)):
            if len(piece) <= packet:
                children[node][slot] = -1 - 8 * (len(order) // packet)
                order.extend([*piece.tolist(), *[-1] * (packet - len(piece))])
            else:
                children[node][slot] = emit(piece)
        return node

    emit(np.arange(len(lower)))
    links, places = np.array(children, np.int32), np.array(order, np.int32)
    return Tree(refit(links, places, packet, lower, upper), links, places, walk(links)[1])


@pytest.mark.parametrize(
    ("kind", "share"),
    [
        (uniform, 0.9), (clustered, 0.5), (points, 0.8), (flat, 0.95), (scales, 0.85), (giant, 0.55),
        (nested, 0.85), (extreme, 0.9), (ordered, 1), (octaves, 0.3),
    ],
)  # fmt: skip
def test_cost_is_below_a_median_split(kind: Callable[..., Boxes], share: float, build: Build) -> None:
    """By the share that splits by the area should gain; boxes in an even row leave nothing to gain."""
    rng = np.random.default_rng(7)
    lower, upper = kind(5000, rng)
    tree, median = build(lower, upper), median_split(lower, upper, 8)
    check(median, lower, upper, 8)
    limit = share * cost(median.bounds, median.children)
    assert cost(tree.bounds, tree.children) <= limit
    # The negative control: the same tree, over primitives in another order.
    shuffle = np.append(rng.permutation(len(lower)), -1).astype(np.int32)
    order = shuffle[tree.order]
    bounds = refit(tree.children, order, 8, lower, upper)
    check(Tree(bounds, tree.children, order, tree.depth), lower, upper, 8)
    assert cost(bounds, tree.children) > limit


def overlaps(origin: Array, inverse: Array, lower: Array, upper: Array) -> Array:
    """Whether rays meet boxes, in doubles; an inverted box never.

    Rounding is monotonic: a box within another is met only where that one is, also after rounding.
    """
    near, far = np.where(inverse > 0, lower, upper), np.where(inverse > 0, upper, lower)
    return ((near - origin) * inverse).max(-1).clip(min=0) <= ((far - origin) * inverse).min(-1)


def traverse(tree: Tree, packet: int, lower: Array, upper: Array, origin: Array, inverse: Array) -> tuple[Array, int]:
    """The boxes that each ray meets, and how many it was held against."""
    met = np.zeros((len(origin), len(lower)), bool)
    tests = 0
    stack = [(0, np.arange(len(origin)))]
    while stack:
        node, rays = stack.pop()
        box = tree.bounds[node].T
        hit = overlaps(origin[rays, None], inverse[rays, None], box[:, :3], box[:, 3:])
        for slot, child in enumerate(tree.children[node].tolist()):
            inside = rays[hit[:, slot]]
            if child == EMPTY:
                assert len(inside) == 0, "a ray meets an empty slot"
            elif child >= 0:
                stack.append((child, inside))
            else:
                first, count = (-1 - child) // 8, (-1 - child) % 8 + 1
                index = tree.order[first * packet : (first + count) * packet]
                index = index[index != -1]
                met[np.ix_(inside, index)] = overlaps(
                    origin[inside, None], inverse[inside, None], lower[index], upper[index]
                )
                tests += len(inside) * len(index)
    return met, tests


@pytest.mark.parametrize("packet", [1, 8])
@pytest.mark.parametrize(
    ("kind", "reach"),
    [
        (uniform, 6),
        (clustered, 6),
        (flat, 8),
        (scales, 1e6),
        (giant, 6),
        (nested, 20),
        (extreme, FMAX),
        (ordered, 1500),
    ],
)
def test_rays_meet_the_same_boxes(kind: Callable[..., Boxes], reach: float, packet: int, build: Build) -> None:
    rng = np.random.default_rng(11)
    lower, upper = kind(1200, rng)
    # From anywhere, each towards a point in a box of its own.
    origin = rng.uniform(-reach, reach, (80, 3))
    aim = rng.choice(len(lower), len(origin), replace=False)
    target = lower[aim] + rng.random((len(origin), 3)) * (upper[aim].astype(np.float64) - lower[aim])
    inverse = 1 / (target - origin)
    tree = build(lower, upper, packet)
    met, tests = traverse(tree, packet, lower, upper, origin, inverse)
    brute = overlaps(origin[:, None], inverse[:, None], lower, upper)
    assert np.array_equal(met, brute)
    assert brute.any(axis=1).mean() > 0.5
    if kind in (uniform, clustered, giant):
        assert tests < 0.2 * brute.size
    # The negative control: a leaf's box without what is in it.
    leaves = leaves_of(tree.children)
    owner = np.repeat(np.arange(len(leaves.node)), leaves.count * packet)
    lost = owner[np.flatnonzero(tree.order == np.argmax(brute.any(axis=0)))[0]]
    bounds = tree.bounds.copy()
    bounds[leaves.node[lost], :, leaves.slot[lost]] = [np.inf] * 3 + [-np.inf] * 3
    assert not np.array_equal(traverse(tree._replace(bounds=bounds), packet, lower, upper, origin, inverse)[0], brute)


@pytest.mark.parametrize(
    ("lower", "upper", "message"),
    [
        ((4, 2), (4, 2), "lower and upper must both have shape (n, 3), not (4, 2) and (4, 2)"),
        ((3,), (3,), "lower and upper must both have shape (n, 3), not (3,) and (3,)"),
        ((4, 3), (5, 3), "lower and upper must both have shape (n, 3), not (4, 3) and (5, 3)"),
        ((4, 3), (2, 2, 3), "lower and upper must both have shape (n, 3), not (4, 3) and (2, 2, 3)"),
        ((0, 3), (0, 3), "a hierarchy needs at least one box, and lower has none"),
    ],
)
def test_bad_shapes(lower: tuple[int, ...], upper: tuple[int, ...], message: str, build: Build) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        build(np.zeros(lower, np.float32), np.ones(upper, np.float32))


@pytest.mark.parametrize(
    ("corner", "value", "fault"),
    [
        ("lower", np.nan, "has a corner that is not finite"),
        ("upper", np.nan, "has a corner that is not finite"),
        ("lower", -np.inf, "has a corner that is not finite"),
        ("upper", np.inf, "has a corner that is not finite"),
        ("lower", 1.001, "has lower > upper"),
        ("upper", -0.001, "has lower > upper"),
    ],
)
@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("threads", [1, 16])
def test_bad_boxes(corner: str, value: float, fault: str, axis: int, threads: int, build: Build) -> None:
    """The first of them is named, on any number of threads."""
    corners = {"lower": np.zeros((LARGE, 3), np.float32), "upper": np.ones((LARGE, 3), np.float32)}
    corners[corner][[2500, 30_000, LARGE - 1], axis] = value
    with pytest.raises(ValueError, match=f"^box 2500 {re.escape(fault)}$"):
        build(**corners, threads=threads)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"packet": 0}, "packet must be from 1 to 64, not 0"),
        ({"packet": -8}, "packet must be from 1 to 64, not -8"),
        ({"packet": 65}, "packet must be from 1 to 64, not 65"),
        ({"threads": -1}, "threads must be from 0 to 1024, not -1"),
        ({"threads": 1025}, "threads must be from 0 to 1024, not 1025"),
    ],
)
def test_bad_options(options: dict[str, int], message: str, build: Build) -> None:
    corners = np.zeros((4, 3), np.float32)
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        build(corners, corners, **options)


def test_defaults(build: Build) -> None:
    """Packets of eight; zero threads are one for each processor."""
    lower, upper = uniform(1000, np.random.default_rng(2))
    for a, b in zip(build(lower, upper)[:3], build(lower, upper, 8, 1)[:3], strict=True):
        assert np.array_equal(a, b)
    check(build(lower, upper, packet=8, threads=0), lower, upper, 8)
