"""The parts of the work-precision benchmark: scenes as numbers, measuring, and one module per engine."""

# engine -> module of this folder; each is imported in a process of its own, since their libraries clash
PEERS = {
    "mujoco": "with_mujoco",
    "drake": "with_drake",
    "exudyn": "with_exudyn",
    "jiminy": "with_jiminy",
    "pinocchio": "with_pinocchio",
}
