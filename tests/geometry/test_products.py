"""Products by oneDNN equal those of PyTorch, with their gradients, and are used where they are faster."""

import pytest
import torch
from torch import nn
from torch.autograd import forward_ad
from torch.fx.experimental.proxy_tensor import make_fx

from riginv.geometry import products
from riginv.geometry.kernels.library import kernels, pure_torch
from riginv.geometry.products import linear, matmul
from riginv.networks.mlp import Linear

HAS_ONEDNN = torch.backends.mkldnn.is_available() and hasattr(torch.ops.mkldnn, "_linear_pointwise")
needs_onednn = pytest.mark.skipif(not HAS_ONEDNN or kernels() is None, reason="PyTorch without oneDNN, or no kernels")


@pytest.fixture
def counted(monkeypatch):
    """The number of products by oneDNN, which is chosen on every machine."""
    calls, product = [], products._product

    def count(*given):
        calls.append(given)
        return product(*given)

    monkeypatch.setattr(products, "prefers_onednn", lambda: True)
    monkeypatch.setattr(products, "_product", count)
    return calls


@needs_onednn
@pytest.mark.parametrize("rows", [8, 64, 65])
@pytest.mark.parametrize("is_biased", [True, False])
def test_products_equal_those_of_pure_torch(counted, rows, is_biased):
    generator = torch.Generator().manual_seed(rows)
    inputs, weight = torch.randn(rows, 37, generator=generator), torch.randn(21, 37, generator=generator)
    bias = torch.randn(21, generator=generator) if is_biased else None
    given = [each for each in (inputs, weight, bias) if each is not None]
    for each in given:
        each.requires_grad_()
    found = linear(*given)
    with pure_torch():
        expected = linear(*given)
    assert len(counted) == 1
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-5)
    wanted = torch.randn(found.shape, generator=generator)
    for of_found, of_expected in zip(torch.autograd.grad(found, given, wanted), torch.autograd.grad(expected, given, wanted)):
        torch.testing.assert_close(of_found, of_expected, rtol=1e-5, atol=1e-4)
    assert len(counted) == 3  # no more than the forward pass and one for each of inputs and weights


@needs_onednn
def test_gradients_have_gradients(counted):
    inputs, weight = torch.randn(9, 12).requires_grad_(), torch.randn(8, 12).requires_grad_()

    def second() -> tuple[torch.Tensor, ...]:
        first = torch.autograd.grad(linear(inputs, weight).pow(3).sum(), inputs, create_graph=True)[0]
        return torch.autograd.grad(first.square().sum(), (inputs, weight))

    found = second()
    assert counted
    with pure_torch():
        expected = second()
    for each, other in zip(found, expected):
        torch.testing.assert_close(each, other, rtol=1e-4, atol=1e-2)


@needs_onednn
def test_views_are_multiplied_as_they_are(counted):
    wide, right = torch.randn(16, 40), torch.randn(30, 24).T
    torch.testing.assert_close(matmul(wide[:, :24], right), wide[:, :24] @ right, rtol=1e-5, atol=1e-5)
    assert len(counted) == 1


@needs_onednn
@pytest.mark.filterwarnings("ignore:.*torch.jit.script:DeprecationWarning")  # which PyTorch's forward mode uses
def test_what_onednn_does_not_take_is_left_to_pytorch(counted):
    weight = torch.randn(6, 5)
    linear(torch.randn(2, 5), weight)  # a few rows
    linear(torch.randn(16, 5).double(), weight.double())
    linear(torch.randn(3, 16, 5), weight)
    with torch.autocast("cpu", torch.bfloat16):
        assert linear(torch.randn(16, 5), weight).dtype == torch.bfloat16
    torch.func.vmap(lambda row: linear(row.expand(16, 5), weight))(torch.randn(4, 5))
    for bias in (torch.tensor(1.0), torch.ones(1), torch.randn(16, 6)):  # they are broadcast
        inputs = torch.randn(16, 5)
        assert torch.equal(linear(inputs, weight, bias), nn.functional.linear(inputs, weight, bias))
    with pytest.raises(RuntimeError, match="shapes cannot be multiplied"):
        linear(torch.randn(16, 5), torch.randn(6, 4))
    with forward_ad.dual_level():
        bias = forward_ad.make_dual(torch.randn(6), torch.ones(6))
        assert forward_ad.unpack_dual(linear(torch.randn(16, 5), weight, bias)).tangent is not None
    assert not counted


@needs_onednn
@pytest.mark.filterwarnings("ignore::torch.jit.TracerWarning", "ignore:.*torch.jit.trace:DeprecationWarning")
def test_a_traced_layer_is_pytorchs_own(counted):
    layer, inputs = Linear(5, 6), torch.randn(16, 5)
    traced = torch.jit.trace(layer, inputs, check_trace=False)
    assert not counted
    torch.testing.assert_close(traced(2 * inputs), layer(2 * inputs), rtol=1e-5, atol=1e-5)


@needs_onednn
def test_layers_use_it_and_keep_the_names_of_their_weights(counted):
    layer, plain = Linear(5, 6), nn.Linear(5, 6)
    plain.load_state_dict(layer.state_dict())
    inputs = torch.randn(16, 5)
    torch.testing.assert_close(layer(inputs), plain(inputs), rtol=1e-5, atol=1e-5)
    assert len(counted) == 1


@needs_onednn
def test_a_program_traced_for_any_batch_takes_any(counted):
    weight = torch.randn(6, 5)
    program = make_fx(lambda rows: linear(rows, weight), tracing_mode="symbolic", _allow_non_fake_inputs=True)
    traced = program(torch.randn(16, 5))
    assert not counted and all("mkldnn" not in str(node.target) for node in traced.graph.nodes)
    rows = next(iter(traced.graph.nodes)).meta["val"].shape[0].node
    assert not [str(guard.expr) for guard in rows.shape_env.guards if str(rows.expr) in str(guard.expr)]


@pytest.mark.parametrize(
    "maker, capability, preferred",
    [("AuthenticAMD", "AVX512", True), ("GenuineIntel", "AVX512", False), ("AuthenticAMD", "AVX2", False)],
)
@needs_onednn
def test_onednn_is_for_avx512_of_amd(monkeypatch, tmp_path, maker, capability, preferred):
    facts = tmp_path / "cpuinfo"
    facts.write_text(f"processor : 0\nvendor_id : {maker}\n")
    monkeypatch.setattr(products, "CPU_FACTS", facts)
    monkeypatch.setattr(torch.backends.cpu, "get_cpu_capability", lambda: capability)
    assert products.prefers_onednn.__wrapped__() is preferred
