"""The families that come with the library, by name."""

from curricle.tasks.families.blocks import block_dude_family
from curricle.tasks.families.cliffs import cliff_walking_family
from curricle.tasks.families.family import TaskFamily
from curricle.tasks.families.lakes import frozen_lake_family
from curricle.tasks.families.mazes import maze_family
from curricle.tasks.families.pursuits import pursuit_family
from curricle.tasks.families.rivers import river_swim_family
from curricle.tasks.families.rooms import four_rooms_family, key_lock_pit_family
from curricle.tasks.families.seas import deep_sea_family
from curricle.tasks.families.taxis import taxi_family

BUILT_IN: dict[str, TaskFamily] = {
    one.name: one
    for one in (
        maze_family,
        pursuit_family,
        frozen_lake_family,
        cliff_walking_family,
        taxi_family,
        four_rooms_family,
        key_lock_pit_family,
        block_dude_family,
        river_swim_family,
        deep_sea_family,
    )
}
"""Name -> family."""
