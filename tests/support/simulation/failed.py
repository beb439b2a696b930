"""Every schedule that ever failed, shrunk: `make test` plays each. `python -m simulation` prints new ones."""

from simulation.chosen import Chosen, Fault
from simulation.shrinking import Failure

FAILED = (
    # An alarm was cleared while the broker refused it, and so it was retained for ever.
    Failure(
        seed=13,
        presses=4,
        chosen=Chosen(brokers=1, has_archive=True, rates={}, sloth_s=0.01, fps=9.0),
        schedule=(
            Fault(at_s=4.0, name="unplug", seed=3407308503),
            Fault(at_s=5.168347, name="hang up", seed=1665571149),
        ),
        says="broker# retains the alarms #, and raised are #",
    ),
    # The old gel's count waited while the gel was changed, and was retained over the new gel.
    Failure(
        seed=211,
        presses=37,
        chosen=Chosen(brokers=1, has_archive=True, rates={}, sloth_s=0.01, fps=7.0),
        schedule=(
            Fault(at_s=20.341307, name="shake", seed=1797386489),
            Fault(at_s=26.464291, name="shake", seed=1061029362),
            Fault(at_s=37.262464, name="hang up", seed=2059440986),
            Fault(at_s=59.481344, name="unplug", seed=854591979),
            Fault(at_s=65.865461, name="replace gel", seed=569618042),
        ),
        says="broker# retains the gel SIM## with # presses, which is not so",
    ),
    # A press was hidden by a covered sensor, and its peak of seconds ago passed when another part was lifted.
    Failure(
        seed=2013,
        presses=8,
        chosen=Chosen(brokers=1, has_archive=False, rates={}, sloth_s=0.0, fps=18.75),
        schedule=(
            Fault(at_s=4.21717, name="kill", seed=145657507),
            Fault(at_s=6.946007, name="damage", seed=112791548),
            Fault(at_s=10.243912, name="blind", seed=187489564),
        ),
        says="press # is glaring and passed #",
    ),
)
