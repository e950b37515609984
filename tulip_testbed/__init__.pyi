"""What `import tulip_testbed` offers, for type checkers and editors."""

from tulip_testbed import effects as effects
from tulip_testbed import plans as plans
from tulip_testbed.api import InputError as InputError
from tulip_testbed.api import Laboratory as Laboratory
from tulip_testbed.api import atlas as atlas
from tulip_testbed.api import check as check
from tulip_testbed.api import describe_plan as describe_plan
from tulip_testbed.api import describe_robot as describe_robot
from tulip_testbed.api import discover as discover
from tulip_testbed.api import draw_plan as draw_plan
from tulip_testbed.api import export_model as export_model
from tulip_testbed.api import identify as identify
from tulip_testbed.api import import_table as import_table
from tulip_testbed.api import list_effects as list_effects
from tulip_testbed.api import load_robot as load_robot
from tulip_testbed.api import monte_carlo as monte_carlo
from tulip_testbed.api import next_experiment as next_experiment
from tulip_testbed.api import optimize_plan as optimize_plan
from tulip_testbed.api import predict as predict
from tulip_testbed.api import protocol as protocol
from tulip_testbed.api import read_measurements as read_measurements
from tulip_testbed.api import report as report
from tulip_testbed.api import simulate as simulate
from tulip_testbed.api import tolerance as tolerance
from tulip_testbed.api import validate as validate
from tulip_testbed.api import view as view
from tulip_testbed.api import watch as watch
from tulip_testbed.api import write_measurements as write_measurements

__all__: list[str]
