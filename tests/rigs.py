"""A rig folder as a discovery writes it."""

from tulip_testbed.experiments.rig_folder import rig_files


def write_rig(folder, robot, effects):
    folder.mkdir()
    for name, text in rig_files(robot, effects).items():
        (folder / name).write_text(text)
