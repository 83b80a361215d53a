"""Networks side by side are each the network that its formula says."""

import numpy as np
import torch

from faultline.training.stack import Stack


def test_each_function_is_its_own_network() -> None:
    torch.manual_seed(1)
    stack = Stack(np.array([[0, 2, 5], [1, 3, 4]]), members=2, hidden=(4, 3), small=1.0, padding=5)
    columns = torch.randn(2, 6, 7)
    columns[:, 5] = 0.0
    found = stack(columns)
    for member in range(2):
        for function, used in enumerate(([0, 2, 5], [1, 3, 4])):
            row = 2 * member + function
            a = columns[member, used]
            first = stack.first[row] @ a + stack.bias[row]
            h = torch.relu(first[1:])
            h = torch.relu(stack.weights[0][row] @ h + stack.biases[0][row])
            out = first[0] + (stack.weights[1][row] @ h + stack.biases[1][row])[0]
            assert torch.allclose(found[member, function], out, atol=1e-6)


def test_a_stack_without_hidden_layers_is_linear() -> None:
    stack = Stack(np.array([[0, 1]]), members=1, hidden=(), small=1.0, padding=2)
    stack.set_linear(torch.tensor([[[2.0, -1.0]]]), torch.tensor([[0.5]]))
    columns = torch.tensor([[[1.0, 3.0], [2.0, 1.0], [0.0, 0.0]]])
    assert stack(columns).tolist() == [[[0.5, 5.5]]]
