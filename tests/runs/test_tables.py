"""The table at the end: what it shows of a result."""

from riginv.runs.tables import print_results


def metrics(name: str, mean: float, **more: float) -> dict:
    values = {"mean_vertex_error_mm": mean, "neutral_mean_vertex_error_mm": 2.0, "mean_of_max_vertex_error_mm": 3.0}
    return {f"{name}/{key}": value for key, value in (values | {"max_vertex_error_mm": 4.0} | more).items()}


def row_of(text: str, name: str) -> list[str]:
    return next(line for line in text.splitlines() if line.strip().startswith(name)).split()[len(name.split()) :]


def test_a_multiple_of_the_best_is_shown_where_there_is_one(capsys):
    far = metrics("random_combinations", 0.5, optimum_mean_vertex_error_mm=0.4, optimum_ratio=1.25)
    exact = metrics("rig_poses", 0.084, optimum_mean_vertex_error_mm=5e-4, optimum_ratio=84.0)
    unknown = metrics("capture", 0.2, roughness=2e-4)
    bound = metrics("walk", 0.5, optimum_mean_vertex_error_mm=0.4, optimum_ratio=1.25, optimum_is_bound=1.0)
    print_results(far | exact | unknown | bound | {"true_rig": "face"}, "done")
    text = capsys.readouterr().out
    assert row_of(text, "random combinations") == ["0.50", "2.00", "3.00", "4.00", "25%", "1.25", "-"]
    assert row_of(text, "rig poses") == ["0.084", "2.00", "3.00", "4.00", "4%", "exact", "-"]
    assert row_of(text, "capture") == ["0.20", "2.00", "3.00", "4.00", "10%", "-", "2.0e-04"]
    assert row_of(text, "walk") == ["0.50", "2.00", "3.00", "4.00", "25%", ">=", "1.25", "-"]
    assert "exact: that least is below 0.005 mm" in text and "Evaluated on the true rig, face" in text
