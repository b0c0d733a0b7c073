"""A campaign's summaries return what the camera was planted with."""

from isetval import load_campaign, load_model, measure_campaign, simulate
from isetval.tomlfile import data_folder


def test_gain_and_read_noise_of_a_simulated_session_lie_within_their_error_bars():
    model = load_model(data_folder() / "pixel4a" / "camera.toml")
    plan = load_campaign(data_folder() / "demo" / "plan.toml").session("A")
    plan = plan.only(s.name for s in plan.shots if s.role in ("dark", "flat"))
    table = measure_campaign(simulate(model, plan, seed=11))
    rows = [m for m in table.metrics if m.summary]
    planted = {"gain_dn_per_e": 0.1707, "read_noise_dn": 2.954 * 0.1707, "dark_current_dn_per_s": 0.261 * 0.1707}
    for name, value in planted.items():
        found = [m for m in rows if m.name == name]
        assert {m.channel for m in found} == {"R", "Gr", "Gb", "B"}
        for m in found:
            assert abs(m.value - value) < 4 * m.sigma, (name, m.channel, m.value, m.sigma)


def test_summaries_can_be_left_out():
    model = load_model(data_folder() / "pixel4a" / "camera.toml")
    plan = load_campaign(data_folder() / "demo" / "plan.toml").session("A")
    plan = plan.only([s.name for s in plan.shots if s.role == "dark"][:2])
    captures = simulate(model, plan, seed=1)
    plain = measure_campaign(captures, summaries=False)
    assert not any(m.summary for m in plain.metrics)
    assert [m.key() for m in measure_campaign(captures).metrics if not m.summary] == [m.key() for m in plain.metrics]
