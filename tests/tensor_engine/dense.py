"""Factors of small meshes as dense matrices: what the batch engine asks of any factor."""

import torch
from torch import Tensor


class Dense:
    """One dense matrix a slot, ordered so that the condensed nodes come last; `free` (n,) bool nodes that can move."""

    dtype = torch.float64

    def __init__(self, conn: Tensor, free: Tensor) -> None:
        self.dofs = (3 * conn[:, :, None] + torch.arange(3)).flatten(1)
        self.free, self.kept, self.factored = free, {}, 0

    def _eliminated(self, K: Tensor, nodes: Tensor) -> tuple[bool, Tensor, tuple]:
        n = 3 * len(self.free)
        whole = torch.zeros(n, n, dtype=K.dtype)
        whole.index_put_((self.dofs[:, :, None], self.dofs[:, None, :]), K, accumulate=True)
        held = (~self.free).repeat_interleave(3) | (whole.diagonal() == 0)  # bonded and void nodes
        last = (3 * nodes[nodes >= 0][:, None] + torch.arange(3)).flatten()
        first = ~held
        first[last] = False
        first = torch.nonzero(first).squeeze(1)
        L, info = torch.linalg.cholesky_ex(whole[first][:, first])
        W = torch.linalg.solve_triangular(L, whole[first][:, last], upper=False)
        S = torch.eye(3 * len(nodes), dtype=K.dtype)
        S[: len(last), : len(last)] = whole[last][:, last] - W.T @ W
        self.factored += 1
        return not int(info), S, (first, last, L, W)

    def reserve(self, nodes: int) -> bool:
        return False

    def factor(self, slots: Tensor, K: Tensor, nodes: Tensor, fewest: int = 0) -> tuple[Tensor, Tensor]:
        each = [self._eliminated(k, m) for k, m in zip(K, nodes, strict=True)]
        self.kept |= {slot: parts for slot, (_, _, parts) in zip(slots.tolist(), each, strict=True)}
        return torch.tensor([good for good, _, _ in each]), torch.stack([S for _, S, _ in each])

    def schur(self, K: Tensor, nodes: Tensor, fewest: int = 0) -> tuple[Tensor, Tensor]:
        each = [self._eliminated(k, m) for k, m in zip(K, nodes, strict=True)]
        return torch.tensor([good for good, _, _ in each]), torch.stack([S for _, S, _ in each])

    def forward(self, slots: Tensor, g: Tensor, nodes: int) -> tuple[Tensor, Tensor]:
        y, loads = torch.zeros_like(g), []
        for row, (slot, flat) in enumerate(zip(slots.tolist(), g.flatten(1), strict=True)):
            first, last, L, W = self.kept[slot]
            part = torch.linalg.solve_triangular(L, flat[first, None], upper=False).squeeze(1)
            y[row].view(-1)[first] = part
            load = flat[last] - W.T @ part
            loads.append(torch.nn.functional.pad(load, (0, 3 * nodes - len(load))))
        return y, torch.stack(loads)

    def expand(self, slots: Tensor, u: Tensor, y: Tensor) -> Tensor:
        p = torch.zeros_like(y)
        for row, slot in enumerate(slots.tolist()):
            first, last, L, W = self.kept[slot]
            v = u[row, : len(last)]
            right = -y[row].view(-1)[first] - W @ v
            p[row].view(-1)[first] = torch.linalg.solve_triangular(L.T, right[:, None], upper=True).squeeze(1)
            p[row].view(-1)[last] = v
        return p
