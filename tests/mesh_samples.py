"""Surfaces to test with, as vertices (n, 3) and triangles (m, 3) wound anticlockwise seen from outside."""

import numpy as np

BOX_TRIANGLES = np.array(
    [[0, 3, 1], [0, 2, 3], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4], [2, 7, 3], [2, 6, 7], [0, 6, 2], [0, 4, 6],
     [1, 3, 7], [1, 7, 5]]
)  # fmt: skip


def box(half_extents=(0.5, 0.5, 0.5), center=(0.0, 0.0, 0.0)):
    """Eight corners, twelve triangles."""
    signs = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], float)
    return signs * half_extents + np.asarray(center, float), BOX_TRIANGLES


def tetrahedron():
    """The corner of a cube: volume 1/6."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    return vertices, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def torus(large=1.0, small=0.4, around=24, across=12):
    """A ring about z: not convex, and not simply connected."""
    u, v = np.meshgrid(
        2 * np.pi * np.arange(around) / around, 2 * np.pi * np.arange(across) / across, indexing="ij"
    )
    r = large + small * np.cos(v)
    vertices = np.stack([r * np.cos(u), r * np.sin(u), small * np.sin(v)], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")

    def number(i, j):
        return (i % around) * across + j % across

    a, b, c, d = number(i, j), number(i + 1, j), number(i + 1, j + 1), number(i, j + 1)
    return vertices, np.stack([a, b, c, a, c, d], -1).reshape(-1, 3)


def sphere(divisions=3, radius=1.0, center=(0.0, 0.0, 0.0)):
    """An icosahedron whose triangles are cut in four `divisions` times: 20 · 4^divisions triangles."""
    golden = (1 + 5**0.5) / 2
    vertices = np.array(
        [[-1, golden, 0], [1, golden, 0], [-1, -golden, 0], [1, -golden, 0], [0, -1, golden], [0, 1, golden],
         [0, -1, -golden], [0, 1, -golden], [golden, 0, -1], [golden, 0, 1], [-golden, 0, -1], [-golden, 0, 1]]
    )  # fmt: skip
    triangles = np.array(
        [[0, 11, 5], [0, 5, 1], [0, 1, 7], [0, 7, 10], [0, 10, 11], [1, 5, 9], [5, 11, 4], [11, 10, 2], [10, 7, 6],
         [7, 1, 8], [3, 9, 4], [3, 4, 2], [3, 2, 6], [3, 6, 8], [3, 8, 9], [4, 9, 5], [2, 4, 11], [6, 2, 10],
         [8, 6, 7], [9, 8, 1]]
    )  # fmt: skip
    for _ in range(divisions):
        sides = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], -1).reshape(-1, 2), axis=1)
        edges, edge = np.unique(sides, axis=0, return_inverse=True)
        middle = len(vertices) + edge.reshape(-1, 3)
        vertices = np.concatenate([vertices, vertices[edges].mean(axis=1)])
        a, b, c = triangles.T
        ab, bc, ca = middle.T
        triangles = np.concatenate(
            [np.stack(t, -1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        )
    vertices = vertices / np.linalg.norm(vertices, axis=-1, keepdims=True)
    return radius * vertices + np.asarray(center, float), triangles


def joined(*surfaces):
    """Several surfaces as one, in the order given."""
    counts = np.cumsum([0] + [len(vertices) for vertices, _ in surfaces])
    return (
        np.concatenate([vertices for vertices, _ in surfaces]),
        np.concatenate([triangles + count for (_, triangles), count in zip(surfaces, counts)]),
    )
