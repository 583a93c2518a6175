"""Trains the detector. One thread, one seed: the same weights every time.

    python3 train.py DATASET OUT.npz [--trunk small] [--epochs 14] [--frames N] [--seed 1]
        [--rate 3e-3] [--from OUT.npz] [--teacher OUT.npz] [--prune SHARE]

Another trunk, a teacher or pruning are experiments; what came of them is in ../README.md.
"""

import argparse
import hashlib
import time

import numpy as np
import torch
from torch import nn

from data import CLASSES, Split
from net import Detector, load, multiplications, normalised, prunable
from scores import judged

BATCH = 32
# What a cell with something counts against one with nothing.
SOMETHING = 4.0
# Share of the loss that follows the teacher, and how much its answers are softened.
FOLLOW, SOFTEN = 0.5, 2.0


def varied(frames, classes, weights, dice):
    """Mirrored, with other colours, and in another light."""
    if dice.random() < 0.5:
        frames, classes, weights = frames.flip(2), classes.flip(2), weights.flip(2)
    # What has a strong colour keeps one, and no colour means more than another.
    if dice.random() < 0.5:
        frames = frames[..., torch.from_numpy(dice.permutation(3))]
    gain = torch.from_numpy(dice.uniform(0.8, 1.25, (len(frames), 1, 1, 3)).astype(np.float32))
    lift = torch.from_numpy(dice.uniform(-16, 16, (len(frames), 1, 1, 1)).astype(np.float32))
    return (frames.float() * gain + lift).clamp(0, 255), classes, weights


def logits_of(net, split, batch=256):
    net.eval()
    with torch.no_grad():
        parts = [
            net(normalised(torch.from_numpy(np.array(split.frames[at : at + batch]))))
            for at in range(0, len(split), batch)
        ]
    return torch.cat(parts).numpy()


def least_of(net, share):
    """Norms and the channels of them that the layer behind them hears least of."""
    chosen = []
    for norm, reader in prunable(net):
        heard = norm.weight.abs() * reader.weight[:, :, 0, 0].norm(dim=0)
        chosen.append((norm, heard.argsort()[: int(share * len(heard))]))
    return chosen


def silence(channels):
    """Makes channels as if they were not there: the rectifier gives 0 for them."""
    with torch.no_grad():
        for norm, which in channels:
            norm.weight[which] = 0.0
            norm.bias[which] = 0.0


def train(args):
    torch.manual_seed(args.seed)
    torch.set_num_threads(1)
    dice = np.random.default_rng(args.seed)
    train_split = Split(f"{args.dataset}/train", args.frames)
    check_split = Split(f"{args.dataset}/check", 500)
    classes, weights = map(torch.from_numpy, train_split.labels())
    weights = weights * torch.where(classes > 0, SOMETHING, 1.0)
    # Channels last takes two thirds of the time.
    net = Detector(args.trunk).to(memory_format=torch.channels_last)
    if args.begin:
        net.load_state_dict(load(args.begin).state_dict())
    teacher = load(args.teacher) if args.teacher else None
    pruned = least_of(net, args.prune)
    silence(pruned)
    left = multiplications(net, [len(which) for _, which in pruned])
    print(f"{left / 1e6:.2f} million multiplications", flush=True)
    steps = args.epochs * (len(train_split) // BATCH)
    optimiser = torch.optim.AdamW(net.parameters(), lr=args.rate, weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, args.rate, total_steps=steps)
    begun = time.process_time()
    for epoch in range(args.epochs):
        net.train()
        order, total = dice.permutation(len(train_split)), 0.0
        for at in range(0, len(order) - BATCH + 1, BATCH):
            chosen = np.sort(order[at : at + BATCH])
            frames = torch.from_numpy(np.array(train_split.frames[chosen]))
            frames, answer, weight = varied(frames, classes[chosen], weights[chosen], dice)
            # Frames hold their channels last: no copy is made.
            inputs = (frames.permute(0, 3, 1, 2) - 128.0) / 128.0
            logits = net(inputs)
            loss = nn.functional.cross_entropy(logits, answer, reduction="none") * weight
            loss = loss.mean()
            if teacher is not None:
                with torch.no_grad():
                    wanted = (teacher(inputs) / SOFTEN).softmax(1)
                follow = -(wanted * (logits / SOFTEN).log_softmax(1)).sum(1) * weight
                loss = (1 - FOLLOW) * loss + FOLLOW * SOFTEN**2 * follow.mean()
            optimiser.zero_grad(set_to_none=True)
            loss.backward()
            optimiser.step()
            schedule.step()
            silence(pruned)
            total += loss.item()
        if epoch % 2 == 1 or epoch == args.epochs - 1:
            each, every = judged(check_split, logits_of(net, check_split), 0.25).f1()
            told = ", ".join(f"{name} {f1:.3f}" for name, f1 in zip(CLASSES[1:], each))
            spent = time.process_time() - begun
            print(f"epoch {epoch + 1}: loss {total:.1f}, F1 {every:.3f} ({told}), {spent:.0f} s", flush=True)
    state = {name: value.numpy() for name, value in net.state_dict().items()}
    np.savez(args.out, trunk=args.trunk, **state)
    together = b"".join(state[name].tobytes() for name in sorted(state))
    print("weights", hashlib.sha256(together).hexdigest()[:16])


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dataset")
    parser.add_argument("out")
    parser.add_argument("--trunk", default="small")
    parser.add_argument("--epochs", type=int, default=14)
    parser.add_argument("--frames", type=int, help="of the training split; all unless given")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rate", type=float, default=3e-3)
    parser.add_argument("--from", dest="begin", help="weights to begin with")
    parser.add_argument("--teacher", help="weights of the network whose answers are followed")
    parser.add_argument("--prune", type=float, default=0.0, help="share of the widened channels")
    train(parser.parse_args())


if __name__ == "__main__":
    main()
