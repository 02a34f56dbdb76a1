"""Object dictionaries of this project's devices, read from their EDS files.

`hardware.canopen.objects` names the indices used in code; a test compares them with the EDS files.
"""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Final

import canopen
from canopen.objectdictionary import ODVariable

from hardware.canopen.objects import JOINT_PRODUCT, SUPERVISOR_PRODUCT

EDS_FILES: Final[Mapping[int, Path]] = {
    JOINT_PRODUCT: Path(__file__).with_name("joint.eds"),
    SUPERVISOR_PRODUCT: Path(__file__).with_name("supervisor.eds"),
}
"""Electronic data sheet (CiA 306) of every device type, by product code (1018h)."""


@cache  # parsing takes about 10 ms
def variables(product: int, node: int) -> Mapping[tuple[int, int], ODVariable]:
    """Return all entries of a device type's object dictionary for a node number, by (index, sub-index).

    An object without sub-indices has sub-index 0. Callers share the entries and must not change them.
    """
    by_index: dict[tuple[int, int], ODVariable] = {}
    dictionary = canopen.import_od(str(EDS_FILES[product]), node_id=node)
    for index, item in dictionary.indices.items():
        subs = {0: item} if isinstance(item, ODVariable) else item.subindices
        by_index.update({(index, sub): subs[sub] for sub in subs})
    return by_index
