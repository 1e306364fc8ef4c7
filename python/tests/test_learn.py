"""WAD-T and WAD-S in PyTorch: their updates are the Rust trainer's, and their files are its files."""

import dataclasses
import functools
import json
import os
import pathlib
import signal
import subprocess

import numpy as np
import pytest
from conftest import sumos

import wad_cosim

torch = pytest.importorskip("torch")
from wad_cosim import learn  # noqa: E402
from wad_cosim.learn import places, replay, training  # noqa: E402
from wad_cosim.learn.curriculum import Curriculum, Passed, Progress  # noqa: E402
from wad_cosim.learn.training import Learner, Settings  # noqa: E402

#: `cargo test --workspace` builds it.
UPDATE = pathlib.Path(__file__).parents[2] / "target" / "release" / "examples" / "update"
INPUTS = {"raw": "raw", "vector": "vector", "latent": "both"}
BOTH = pytest.mark.parametrize("algo", learn.ALGORITHMS)


def flat(networks, of=lambda parameter: parameter):
    """The parameters as the Rust trainer has them: layer by layer, weights [inputs, outputs] before biases, each of all networks."""
    parts = []
    for layers in zip(*(network.layers for network in networks)):
        parts += [of(layer.weight).T.reshape(-1) for layer in layers] + [of(layer.bias) for layer in layers]
    return torch.cat(parts).detach()


def fill(networks, values):
    at = 0
    with torch.no_grad():
        for layers in zip(*(network.layers for network in networks)):
            for parameter in [layer.weight.T for layer in layers] + [layer.bias for layer in layers]:
                parameter.copy_(values[at : at + parameter.numel()].view(parameter.shape))
                at += parameter.numel()
    assert at == len(values)


def parts_of(algo, agent):
    """The networks under the Rust trainer's names, and the optimisers of some of them."""
    critics = [agent.qf1, agent.qf2]
    if algo == "td3":
        targets = {"actor_target": [agent.actor_target], "critics_target": [agent.qf1_target, agent.qf2_target]}
        return {"actor": [agent.actor], "critics": critics} | targets, ("actor", "critics")
    networks = {"policy": [agent.actor], "critics": critics, "value": [agent.value], "value_target": [agent.value_target]}
    return networks, ("policy", "critics", "value")


@BOTH
@pytest.mark.parametrize("observation", INPUTS)
def test_updates_are_those_of_train_agent(tmp_path, algo, observation):
    if not UPDATE.exists():
        pytest.skip(f"{UPDATE} is not built: cargo build --release --workspace --example update")
    learn.prepare()
    file = tmp_path / "updates.npz"
    subprocess.run([UPDATE, file, algo, INPUTS[observation], "2"], check=True, capture_output=True)
    said = {name: torch.from_numpy(values) for name, values in np.load(file).items()}
    agent = learn.new(algo, observation)
    networks, learned = parts_of(algo, agent)
    for name, each in networks.items():
        fill(each, said[f"before.{name}"])
    if algo == "sac":
        with torch.no_grad():
            agent.log_alpha.copy_(said["before.log_alpha"])
    for update in range(2):
        agent.update(replay.Batch(**{name: said[f"{update}.{name}"] for name in replay.Batch._fields}))
    for name, each in networks.items():
        before, after = said[f"before.{name}"], said[f"after.{name}"]
        # Slow copies move little: they must not differ by a tenth of it either.
        moved = float((after - before).abs().max())
        assert moved > 1e-6, name
        assert (flat(each) - after).abs().max() < min(1e-5, 0.1 * moved), name
    for name in learned:
        optimizer = agent.optimizers["actor" if name == "policy" else name]
        for moment, ours in (("m", "exp_avg"), ("v", "exp_avg_sq")):
            apart = flat(networks[name], lambda parameter: optimizer.state[parameter][ours]) - said[f"after.{name}_adam.{moment}"]
            assert apart.abs().max() < 1e-5, f"{name} {moment}"
    if algo == "sac":
        assert (agent.log_alpha - said["after.log_alpha"]).abs() < 1e-5


def drawn(rng, n, size, terminated=False):
    """A segment."""
    numbers = lambda *shape: rng.normal(0, 1, shape).astype(np.float32)  # noqa: E731
    return replay.Segment(numbers(n + 1, size), np.tanh(numbers(n, 3)), numbers(n), terminated)


def test_batches_sum_rewards_to_the_end_and_no_further():
    buffer = replay.ReplayBuffer(1024, 1)
    # Observation, action and reward k are k; two segments, the first of which ends its episode.
    for first, n, terminated in ((0, 5, True), (10, 4, False)):
        k = np.arange(first, first + n + 1, dtype=np.float32)
        buffer.push(replay.Segment(k[:, None], np.repeat(k[:-1, None], 3, 1), k[:-1], terminated))
    batch = buffer.sample(np.random.default_rng(1), 500, 3, 0.5)
    seen = set()
    for observation, action, reward, after, discount, _ in zip(*batch):
        k = int(observation[0])
        seen.add(k)
        assert (action == k).all()
        last = 5 if k < 10 else 14
        n = min(3, last - k)
        assert after[0] == k + n
        assert reward == sum(0.5**i * (k + i) for i in range(n))
        assert discount == (0 if k + n == 5 else 0.5**n)
    assert seen == {0, 1, 2, 3, 4, 10, 11, 12, 13}, "every transition, and no segment's end"
    assert abs(float(batch.noise.mean())) < 0.1 and abs(float(batch.noise.std()) - 1) < 0.1


def test_a_full_ring_forgets_the_oldest():
    rng, buffer = np.random.default_rng(2), replay.ReplayBuffer(2048, 2)
    for number in range(40):
        segment = drawn(rng, 60, 2)
        segment.observations[:] = number
        buffer.push(segment)
    assert len(buffer) == 2048
    numbers, counts = np.unique(buffer.sample(rng, 4000, 1, 0.9).observation[:, 0].numpy(), return_counts=True)
    # 40 segments of 61 entries; the last 33 of them, and a part of the one before, are there.
    assert numbers.tolist() == [*range(6, 40)] and counts[1:].min() > 70 and counts[1:].max() < 180


def test_segments_end_where_episodes_do():
    ticks, egos = 6, 2
    k = np.arange(ticks + 1, dtype=np.float32)
    observations = np.stack([k, 100 + k], 1)[:, :, None]
    actions = np.repeat(observations[:-1], 3, 2)
    valid, terminated = np.ones((ticks, egos), bool), np.zeros((ticks, egos), bool)
    # The first ego's episode ends in tick 2; in tick 3 it waits, and in tick 4 it begins another.
    terminated[2, 0], valid[3:5, 0] = True, False
    places = np.arange(ticks * egos).reshape(ticks, egos)
    found = list(training.segments(observations, actions, observations[:-1, :, 0], valid, terminated, places, [np.array([70, 71]), np.array([80])]))
    assert [segment.places.tolist() for segment in found] == [[0, 2, 4], [10], [1, 3, 5, 7, 9, 11]]
    assert [segment.observations[:, 0].tolist() for segment in found] == [[0, 1, 2, 3], [5, 6], [*range(100, 107)]]
    assert [segment.rewards.tolist() for segment in found] == [[0, 1, 2], [5], [*range(100, 106)]]
    assert [segment.terminated for segment in found] == [True, False, False]
    assert found[0].lead.tolist() == [70, 71, 0, 2, 4], "what its episode did in the turn before leads to its end too"
    assert found[1].lead is found[2].lead is None


def test_a_place_is_ten_metres_of_ground_in_one_direction():
    here = places.of(12, -3, 0.1)
    assert here == places.of(18, -9, -0.3) and places.of(5, 5, 3.1) == places.of(5, 5, -3.1)
    # The number that crates/wad-learn/src/agent/places.rs gives it.
    assert here == 1 << 31 | 1 << 15 | 0x1FFF << 2
    assert here not in places.of([21, 12, 12], [-3, 3, -3], [0.1, 0.1, 1.6]).tolist()


def test_the_share_near_ends_is_drawn_from_all_that_was_driven_there():
    buffer = replay.ReplayBuffer(1024, 1)
    # Every tenth episode drives at another place than the rest, and half of those end there; the ring overwrites the first 40.
    for episode in range(100):
        numbers = np.full((18, 1), episode, np.float32)
        terminated, there = episode % 20 == 0, np.full(17, 8 if episode % 10 == 0 else 7)
        buffer.push(replay.Segment(numbers, np.zeros((17, 3), np.float32), np.zeros(17, np.float32), terminated, there))

    def episodes(buffer, near_ends):
        batch = buffer.sample(np.random.default_rng(1), 2000, 3, 0.9, near_ends)
        return batch.observation[:, 0].numpy()

    drawn = episodes(buffer, 0.5)
    there = drawn[drawn % 10 == 0]
    assert 0.5 < len(there) / len(drawn) < 0.6, "expected 0.5 + 0.5 * 0.1"
    assert 0.35 < (there % 20 == 0).mean() < 0.65, "half of what was driven there ended there"
    assert (episodes(buffer, 0) % 10 == 0).mean() < 0.15
    # The same from a checkpoint.
    other = replay.ReplayBuffer(1024, 1)
    other.load(buffer.state())
    assert (episodes(other, 0.5) == drawn).all()


def test_what_leads_to_an_end_is_its_own_episode_though_other_egos_segments_lie_between():
    buffer = replay.ReplayBuffer(4096, 1)
    for turn in range(30):
        for ego in range(4):
            # Only the first ego's episodes end, in every third turn; they drive at places 1 to 3, the others elsewhere.
            numbers, last = np.full((17, 1), ego, np.float32), ego == 0 and turn % 3 == 2
            there = np.full(16, 1 + turn % 3 if ego == 0 else 10 + ego)
            lead = np.repeat([1, 2, 3], 16)[-replay.NEAR :] if last else None
            buffer.push(replay.Segment(numbers, np.zeros((16, 3), np.float32), np.zeros(16, np.float32), last, there, lead))
    batch = buffer.sample(np.random.default_rng(1), 1000, 1, 0.9, 1.0)
    assert (batch.observation == 0).all()


def test_where_places_are_not_known_all_is_drawn_alike():
    buffer = replay.ReplayBuffer(1024, 1)
    for episode in range(40):
        numbers = np.full((18, 1), episode, np.float32)
        buffer.push(replay.Segment(numbers, np.zeros((17, 3), np.float32), np.zeros(17, np.float32), episode == 0))
    assert (buffer.sample(np.random.default_rng(1), 1000, 1, 0.9, 1.0).observation == 0).float().mean() < 0.08


CURRICULUM = pathlib.Path(__file__).parents[2] / "scenarios" / "curriculum.json"


def test_stages_follow_on_success_and_at_the_latest_when_their_steps_are_spent():
    curriculum, progress = Curriculum.load(CURRICULUM), Progress()
    for _ in range(19):
        assert progress.note(curriculum, 0, 100, True) is None
    assert progress.note(curriculum, 0, 100, True) == Passed(0, True, 2000, 1.0)
    assert (progress.stage, progress.steps) == (1, 0)
    # An earlier stage's success says nothing about this one.
    assert not any(progress.note(curriculum, 0, 100, True) for _ in range(40))
    spent = progress.note(curriculum, 1, curriculum.stages[1].most_steps, False)
    assert (spent.stage, spent.threshold, progress.stage) == (1, False, 2)
    last = Progress(stage=5)
    passed = [last.note(curriculum, 5, 1000, True) for _ in range(60)]
    assert sum(one is not None for one in passed) == 1 and (last.stage, last.done) == (5, True)


def test_earlier_stages_are_driven_again():
    curriculum, rng = Curriculum.load(CURRICULUM), np.random.default_rng(3)
    drawn = [curriculum.draw(2, rng) for _ in range(400)]
    assert 80 < sum(stage < 2 for stage in drawn) < 160 and set(drawn) == {0, 1, 2}
    assert {curriculum.draw(0, rng) for _ in range(50)} == {0}


@pytest.mark.parametrize(
    ("before", "after", "text"),
    [
        ('"replay"', '"repaly"', "repaly"),
        ('"window": 20, "most_steps": 60000', '"window": 20, "most_step": 1', "most_step"),
        ("0.3", "1.5", "1.5"),
        ('"one_turn"', '"two_turns"', "two_turns"),
        ('"window": 50', '"window": 0', "window"),
        ('"ClearNoon", ', '"Fog", ', "Fog"),
        ('"town": "town3",', "", "town"),
        ("{", "", "curriculum"),
    ],
)
def test_a_curriculum_that_cannot_be(tmp_path, before, after, text):
    path = tmp_path / "c.json"
    path.write_text(CURRICULUM.read_text().replace(before, after, 1))
    with pytest.raises(wad_cosim.InputError, match=text) as error:
        Curriculum.load(path)
    assert "c.json" in str(error.value)


SMALL = {"learning_starts": 128, "buffer": 2048, "batch": 32}


def learned(settings, segments, checkpoint=None):
    """A learner that has taken the segments."""
    learner = Learner(settings, checkpoint)
    for segment in segments:
        state = learner.take([segment])
    return learner, state


@BOTH
@pytest.mark.parametrize("observation", INPUTS)
def test_a_checkpoint_goes_on_bit_for_bit_and_becomes_an_agent(tmp_path, algo, observation):
    settings = Settings(algo=algo, observation=observation, **SMALL)
    size = {"raw": 15, "vector": 187, "latent": 215}[observation]
    rng = np.random.default_rng(3)
    first, then = ([drawn(rng, 40, size, terminated=i % 2 == 0) for i in range(6)] for _ in range(2))
    straight, state = learned(settings, first)
    assert state.steps == 240 and state.updates == 240 - 128 and all(map(np.isfinite, state.losses.values()))
    checkpoint = straight.save()
    assert training.steps_of(checkpoint) == 240
    resumed, found = learned(settings, then, checkpoint)
    for segment in then:
        expected = straight.take([segment])
    assert (found.steps, found.updates, found.losses) == (expected.steps, expected.updates, expected.losses)
    for name, values in expected.weights.items():
        assert (found.weights[name] == values).all(), name

    path = tmp_path / "agent.safetensors"
    training.write_agent(checkpoint, settings, path)
    agent, actor = wad_cosim.load_agent(path), learn.new(algo, observation).actor
    assert agent.observation == observation
    actor.load_state_dict({name: torch.from_numpy(values) for name, values in state.weights.items()})
    # The file rounds weights to half precision, and keeps the scale of the inputs.
    for layer in actor.layers:
        for parameter in layer.parameters():
            parameter.data = parameter.data.half().float()
    if observation == "latent":
        assert (actor.factor[: size - 15] != 1).all() and (actor.factor[size - 15 :] == 1).all()
    else:
        assert (actor.factor == 1).all() and (actor.offset == 0).all()
    for numbers in rng.normal(0, 1, (10, size)).astype(np.float32):
        with torch.no_grad():
            expected = actor(actor.scaled(torch.from_numpy(numbers)[None]))[0].numpy()
        assert np.abs(agent.act(numbers) - expected).max() < 1e-5


def test_moments_of_a_unit_that_is_off_become_zero_not_subnormal():
    learn.prepare()
    parameter = torch.nn.Parameter(torch.ones(2))
    adam = torch.optim.Adam([parameter], lr=1e-3)
    for step in range(2000):
        parameter.grad = torch.tensor([0.0 if step else 1e-3, 1e-3])
        adam.step()
    moment = adam.state[parameter]["exp_avg"].numpy()
    assert moment[0] == 0 and abs(moment[1] - 1e-3) < 1e-7


def test_a_loss_that_is_not_a_number_stops_the_training():
    learner, _ = learned(Settings(**SMALL), [drawn(np.random.default_rng(4), 100, 15)])
    broken = drawn(np.random.default_rng(5), 100, 15)
    broken.rewards[:] = np.nan
    with pytest.raises(wad_cosim.Error, match="losses/qf1_loss is nan"):
        learner.take([broken])


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"algo": "ppo"}, "td3, sac"),
        ({"observation": "image"}, "raw, vector, latent"),
        ({"environments": ("wad_cosim/Nowhere-v0",)}, "Nowhere"),
        ({"egos": 0}, "1 or more"),
        ({"learning_starts": 10}, "a batch"),
        ({"buffer": 10}, "1024"),
    ],
)
def test_settings_that_cannot_be(given, text):
    with pytest.raises(wad_cosim.InputError, match=text):
        Settings(**given).check()


STEPWISE = {
    "town": "town3",
    "weathers": ["ClearNoon", "CloudyNoon"],
    "replay": 0.5,
    "stages": [
        {"task": "straight", "threshold": 0.9, "window": 2, "most_steps": 200},
        {"task": "one_turn", "threshold": 1.0, "window": 5},
    ],
}


def test_a_training_goes_through_its_curriculum_and_resumes_in_it():
    settings = Settings(curriculum=Curriculum.of(STEPWISE), egos=2, segment=30, **SMALL)
    settings.check()
    assert Settings.of(json.loads(json.dumps(dataclasses.asdict(settings)))) == settings
    episode = {"stage": 0, "task": "straight", "charts/episodic_length": 150, "success": False}
    learner, rng = Learner(settings), np.random.default_rng(6)
    assert learner.take([drawn(rng, 150, 15)], [episode]).passed == []
    (passed,) = learner.take([drawn(rng, 150, 15)], [episode]).passed
    assert (passed["stage"], passed["threshold"], passed["step"]) == (0, False, 300) and passed["hours"] > 0
    again = Learner(settings, learner.save())
    assert again.published().stage == learner.published().stage == 1
    assert again.published().hours >= passed["hours"]
    collector, tasks = training.Collector(0, settings), set()
    for turn in range(40):
        tasks |= {(episode["stage"], episode["task"]) for episode in collector.drive(turn, again.published().weights, False, 1)[0]}
        if len(tasks) == 2:
            break
    collector.close()
    assert tasks == {(0, "straight"), (1, "one_turn")}
    for wrong in ({"town": "town5"}, {"environments": ("wad_cosim/OneTurn-v0",)}, {"near_ends": 2}):
        with pytest.raises(wad_cosim.InputError, match="curriculum|near_ends"):
            dataclasses.replace(settings, **wrong).check()


def test_a_collector_drives_what_a_learner_learns_from():
    settings = Settings(egos=3, segment=20, **SMALL)
    collector, learner = training.Collector(0, settings), Learner(settings)
    driven = [collector.drive(turn, learner.published().weights, False) for turn in range(3)]
    steps = 0
    for episodes, found in driven:
        assert len(found) >= 3 and all(len(segment.observations) == len(segment.actions) + 1 for segment in found)
        assert all((segment.places != places.UNKNOWN).all() for segment in found)
        # An ego moves a metre in a tick at most: neighbours in time are neighbours in place.
        assert all(len(set(segment.places.tolist())) <= 1 + len(segment.actions) // 2 for segment in found)
        assert all(np.abs(segment.observations).max() <= 2 and (segment.rewards != 0).any() for segment in found)
        steps += sum(len(segment.actions) for segment in found)
        assert all(episode["charts/episodic_length"] > 0 for episode in episodes)
        state = learner.take(found)
    assert steps == state.steps > 128 and state.updates == steps - 128
    collector.drive(3, state.weights, True)
    collector.close()
    again, later = (training.Collector(0, settings, before) for before in (0, steps))
    first = driven[0][1][0].actions
    for other, is_same in ((again, True), (later, False)):
        _, found = other.drive(0, state.weights, False)
        assert np.array_equal(found[0].actions, first) == is_same, "a training that goes on drives other episodes"
        other.close()


def test_a_collector_outlives_its_sumo_but_not_five_in_a_row():
    settings = Settings(egos=2, segment=10, **SMALL)
    collector, weights = training.Collector(0, settings), Learner(settings).published().weights
    turns = 0

    def drive(dies):
        episodes, found = collector.drive(turns, weights, False)
        assert not any(episode["end"] == "error" for episode in episodes), "SUMO's death is no episode"
        for sumo in sumos() if dies else ():
            os.kill(sumo, signal.SIGKILL)
        return found

    for turns in range(4):
        assert drive(dies=turns == 1) or turns == 2
    with pytest.raises(wad_cosim.Error):
        for turns in range(4, 20):
            drive(dies=True)
    assert turns == 9, "the fifth turn after a death in each"
    collector.close()


def test_a_sumo_that_hangs_costs_its_egos_episodes_only(monkeypatch):
    quick = functools.partial(wad_cosim.DrivingVectorEnv, options={"tick_timeout": 1})
    monkeypatch.setattr(training, "DrivingVectorEnv", quick)
    settings = Settings(egos=2, segment=10, **SMALL)
    collector, weights = training.Collector(0, settings), Learner(settings).published().weights
    assert collector.drive(0, weights, False)[1]
    (hung,) = sumos()
    os.kill(hung, signal.SIGSTOP)
    episodes, _ = collector.drive(1, weights, False)
    assert not any(episode["end"] == "error" for episode in episodes), "it says nothing about driving"
    episodes, found = collector.drive(2, weights, False)
    assert found and hung not in sumos(), "another SUMO drives"
    collector.close()
