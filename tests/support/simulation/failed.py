"""Every schedule that ever failed, shrunk: `make test` plays each. `python -m simulation` prints new ones."""

from simulation.chosen import Chosen, Fault
from simulation.shrinking import Failure

FAILED = (
    # An alarm was cleared while the broker refused it, and so it was retained for ever.
    Failure(
        seed=13,
        presses=4,
        chosen=Chosen(sloth_s=0.01, fps=9.0),
        schedule=(
            Fault(at_s=4.0, name="unplug", seed=49),
            Fault(at_s=5.168347, name="hang up", seed=70),
        ),
        says="broker# retains the alarms #, and raised are #",
    ),
    # The old gel's count waited while the gel was changed, and was retained over the new gel.
    Failure(
        seed=211,
        presses=37,
        chosen=Chosen(sloth_s=0.01, fps=7.0),
        schedule=(
            Fault(at_s=20.341307, name="shake", seed=1797386489),
            Fault(at_s=26.464291, name="shake", seed=1061029362),
            Fault(at_s=37.262464, name="hang up", seed=852),
            Fault(at_s=59.481344, name="unplug", seed=854591979),
            Fault(at_s=65.865461, name="replace gel", seed=569618042),
        ),
        says="broker# retains the gel SIM## with # presses, which is not so",
    ),
    # A press was hidden by a covered sensor, and its peak of seconds ago passed when another part was lifted.
    Failure(
        seed=2013,
        presses=8,
        chosen=Chosen(has_archive=False),
        schedule=(
            Fault(at_s=4.21717, name="kill", seed=145657507),
            Fault(at_s=6.946007, name="damage", seed=112791548),
            Fault(at_s=10.243912, name="blind", seed=187489564),
        ),
        says="press # is glaring and passed #",
    ),
    # At 7 frames a second it took 38 broken ones, five seconds, until the sensor was opened again.
    Failure(
        seed=2021,
        presses=12,
        chosen=Chosen(has_archive=False, fps=7.0),
        schedule=(
            Fault(at_s=4.0, name="damage", seed=383951828),
            Fault(at_s=4.535, name="blind", seed=3231683878),
            Fault(at_s=6.4, name="damage", seed=2019097813),
        ),
        says="the alarm device is not raised # s after its reason came",
    ),
    # Among the pictures of a covered sensor each broken one began the two seconds of blindness anew.
    Failure(
        seed=118,
        presses=7,
        chosen=Chosen(brokers=2, has_archive=False, fps=7.0),
        schedule=(
            Fault(at_s=4.0, name="damage", seed=1394579487),
            Fault(at_s=6.486873, name="blind", seed=3881109521),
        ),
        says="the alarm device is not raised # s after its reason came",
    ),
    # The acknowledgement of the newest `last/press` was lost, and the next connection began with the one before.
    Failure(
        seed=1012,
        presses=30,
        chosen=Chosen(fps=7.0),
        schedule=(Fault(at_s=53.257223, name="hang up", seed=2778470628),),
        says="broker#: what is retained on last/press went back",
    ),
    # The station ended while the broker hung, which then retained `online` and `ready` of a station that was gone.
    Failure(
        seed=3034,
        presses=9,
        chosen=Chosen(sloth_s=0.03, fps=9.0, level="silent at 5"),
        schedule=(
            Fault(at_s=2.080528, name="blind", seed=846731097),
            Fault(at_s=24.904581, name="hang up", seed=3453161778),
            Fault(at_s=29.04306, name="stop", seed=206368166),
        ),
        says="broker# retains `online`, and holds no will",
    ),
    # The station ended before its birth was over, and the broker then held no will, as if it had been told the end.
    Failure(
        seed=57,
        presses=3,
        chosen=Chosen(brokers=2, level="silent at 5", piece="free"),
        schedule=(
            Fault(at_s=2.445576, name="hang up", seed=4207984392),
            Fault(at_s=8.707099, name="lose database", seed=3895884278),
        ),
        says="broker# retains `online`, and holds no will",
    ),
    # A broker hung for five seconds, and what had waited behind the message of then did not say that it was late.
    Failure(
        seed=1003,
        presses=9,
        chosen=Chosen(has_archive=False, fps=7.0),
        schedule=(
            Fault(at_s=4.0, name="stop", seed=2699269205),
            Fault(at_s=17.693607, name="hang up", seed=2330248867),
        ),
        says="broker#: the result of press # came late, and does not say so",
    ),
    # A silence was taken for that of fourteen seconds before, for no opening of the sensor lay between.
    Failure(
        seed=6,
        presses=19,
        chosen=Chosen(has_archive=False, sloth_s=0.03, trigger="command", has_robot=True, plc="modbus"),
        schedule=(
            Fault(at_s=2.253394, name="fill disk", seed=4084754644),
            Fault(at_s=2.919828, name="stop", seed=3976950068),
            Fault(at_s=10.198227, name="silence", seed=1484011695),
            Fault(at_s=20.025487, name="fill disk", seed=3329871780),
            Fault(at_s=20.094882, name="pedal", seed=1288361034),
            Fault(at_s=22.89296, name="pedal", seed=3545799568),
            Fault(at_s=28.328653, name="lose power", seed=3600921411),
            Fault(at_s=28.345015, name="stop", seed=4293653424),
            Fault(at_s=30.915177, name="silence", seed=1243386801),
            Fault(at_s=48.997022, name="fill disk", seed=3414222962),
            Fault(at_s=49.646242, name="silence", seed=2156974019),
        ),
        says="the alarm device is not raised # s after its reason came",
    ),
    # A part lay on the gel when a silence ended: it was the free gel, so what it showed were marks, which were masked.
    Failure(
        seed=263320558,
        presses=41,
        chosen=Chosen(sloth_s=0.03),
        schedule=(Fault(at_s=66.63, name="silence", seed=1),),
        says="press #, sound, has the verdict unsure, without any fault",
    ),
    # The plan of a piece selected the place that is left over another one that a person had selected meanwhile.
    Failure(
        seed=263331928,
        presses=20,
        chosen=Chosen(
            sloth_s=0.01,
            level="silent at 5",
            has_shadow=True,
            has_robot=True,
            piece="free",
            meetings=(
                ("hang up", "stop"),
                ("plc", "second plc"),
                ("blind",),
                ("fill disk", "kill", "hang up"),
            ),
            forgets=True,
        ),
        schedule=(
            Fault(at_s=1.334441, name="hang up", seed=256309937),
            Fault(at_s=5.388006, name="stop", seed=3232768380),
            Fault(at_s=7.539765, name="stop", seed=3285767815),
            Fault(at_s=8.147993, name="damage", seed=3467175296),
            Fault(at_s=13.406646, name="damage", seed=2486524783),
            Fault(at_s=14.738501, name="kill", seed=2260037332),
            Fault(at_s=24.954828, name="damage", seed=4229500834),
        ),
        says="press # lay elsewhere, and its fail is of PZ#/pos#",
    ),
    # A part was lifted while the sensor was away: the first frame afterwards said that it had pressed all the time.
    Failure(
        seed=263332115,
        presses=10,
        chosen=Chosen(
            brokers=2,
            has_archive=False,
            fps=7.0,
            has_shadow=True,
            piece="free",
            meetings=(("kill",), ("hang up", "stop"), ("request", "relay"), ("plc", "unplug")),
        ),
        schedule=(
            Fault(at_s=7.198866, name="replace gel", seed=2499903246),
            Fault(at_s=10.925286, name="replace gel", seed=3801306692),
            Fault(at_s=22.917199, name="replace gel", seed=3985937716),
            Fault(at_s=28.519563, name="stop", seed=3613474702),
            Fault(at_s=28.833698, name="stop", seed=2797971305),
            Fault(at_s=36.255311, name="unplug", seed=1779518773),
        ),
        says="the alarm contact is still raised # s after its reason went",
    ),
    # After a restart the plan of a piece selected the place that is left over another one that a person had selected.
    Failure(
        seed=263332335,
        presses=15,
        chosen=Chosen(
            sloth_s=0.03,
            piece="free",
            meetings=(
                ("plc", "unplug"),
                ("fill disk", "kill", "hang up"),
                ("hang up", "stop"),
                ("select part", "stop"),
            ),
        ),
        schedule=(
            Fault(at_s=38.862242, name="stop", seed=2471391777),
            Fault(at_s=40.350323, name="stop", seed=3885051047),
        ),
        says="press # lay elsewhere, and its fail is of PZ#/pos#",
    ),
    # The free gel was taken for a part at the start, and a trigger waited until it was seen free: its press was judged
    # by the part that was selected before.
    Failure(
        seed=263332448,
        presses=15,
        chosen=Chosen(
            brokers=2,
            sloth_s=0.01,
            fps=9.0,
            outbox_mb=0.03,
            has_file=True,
            plc="opcua",
            piece="fixed",
            meetings=(
                ("silence",),
                ("fill disk", "lose power"),
                ("hang up", "lose database"),
                ("request", "relay"),
            ),
            forgets=True,
        ),
        schedule=(
            Fault(at_s=2.336138, name="silence", seed=4268341137),
            Fault(at_s=12.128794, name="lose power", seed=1103017800),
            Fault(at_s=12.197023, name="fill disk", seed=371925169),
            Fault(at_s=13.091999, name="stop", seed=1377349707),
            Fault(at_s=17.287356, name="plc", seed=1414714485),
            Fault(at_s=19.362965, name="lose power", seed=1581024779),
            Fault(at_s=20.698724, name="lose power", seed=3944588707),
            Fault(at_s=24.275131, name="hang up", seed=3613355265),
            Fault(at_s=24.294661, name="lose database", seed=3088542941),
            Fault(at_s=30.999977, name="lose database", seed=3318836495),
            Fault(at_s=33.353117, name="lose database", seed=3811335059),
            Fault(at_s=33.474676, name="lose power", seed=2766202779),
            Fault(at_s=34.760091, name="lose database", seed=2663069035),
        ),
        says="trigger #: press # lay at PZ#, and its pass is of PZ#",
    ),
    # No fault of the station: a person began a piece while the trigger of a PLC that names another was on its way.
    Failure(
        seed=263341156,
        presses=11,
        chosen=Chosen(
            brokers=2,
            has_archive=False,
            sloth_s=0.03,
            has_shadow=True,
            plc="modbus",
            piece="fixed",
            meetings=(
                ("fill disk", "kill", "hang up"),
                ("hang up", "lose database"),
                ("plc", "second plc"),
                ("silence",),
            ),
            forgets=True,
        ),
        schedule=(
            Fault(at_s=3.550595, name="fill disk", seed=1869609070),
            Fault(at_s=23.795348, name="lose database", seed=464735910),
            Fault(at_s=26.681437, name="begin piece", seed=1590485514),
        ),
        says="press # counts for piece #, and another piece was begun before it",
    ),
    # No fault of the station: an auditor read the acts of a sensor that was unplugged while reads of the disk failed.
    Failure(
        seed=1,
        presses=3,
        chosen=Chosen(has_archive=False),
        schedule=(Fault(at_s=4.0, name="unplug", seed=5), Fault(at_s=6.0, name="bad disk", seed=89)),
        says="_count_unseen of auditors.py ended it: OperationalError#",
    ),
    # No fault of the station: a person selected another part just as a press began, which a trigger had named.
    Failure(
        seed=263341272,
        presses=6,
        chosen=Chosen(
            brokers=2,
            sloth_s=0.03,
            fps=7.0,
            level="3.1.1",
            plc="modbus",
            meetings=(
                ("hang up", "stop"),
                ("plc", "second plc"),
                ("blind",),
                ("fill disk", "kill", "hang up"),
            ),
            forgets=True,
        ),
        schedule=(
            Fault(at_s=2.71252, name="hang up", seed=3058077282),
            Fault(at_s=11.076941, name="stop", seed=2642158727),
            Fault(at_s=16.176941, name="select part", seed=2907703565),
            Fault(at_s=17.195503, name="select part", seed=3188248530),
        ),
        says="press #, dented, has the verdict rejected, without any fault",
    ),
    # No fault of the station: a person selected a place again just before the plan selected the last one that is left.
    Failure(
        seed=233,
        presses=13,
        chosen=Chosen(brokers=2, sloth_s=0.03, level="silent at 5", has_robot=True, piece="free"),
        schedule=(
            Fault(at_s=11.322969, name="hang", seed=3985718986),
            Fault(at_s=13.034032, name="hang", seed=3130977302),
            Fault(at_s=15.547557, name="hang", seed=4047613911),
            Fault(at_s=17.537416, name="hang", seed=2410658526),
        ),
        says="press # lay elsewhere, and its fail is of PZ#/pos#",
    ),
    # The loop hung over a press, and the one before it was shown as one that may be lifted.
    Failure(
        seed=14,
        presses=2,
        chosen=Chosen(sloth_s=0.03, fps=9.0, has_file=True, has_shadow=True, plc="opcua"),
        schedule=(
            Fault(at_s=4.0, name="hang", seed=1594852426),
            Fault(at_s=12.061699, name="hang", seed=2201477749),
        ),
        says="lift was shown at # s, and the loop hung since its press was seen",
    ),
    # A frame that the driver had kept while the process was frozen told that the part of now may be lifted.
    Failure(
        seed=263341421,
        presses=6,
        chosen=Chosen(
            level="3.1.1",
            has_robot=True,
            piece="free",
            meetings=(
                ("plc", "second plc"),
                ("freeze", "hold back"),
                ("select part", "replace gel"),
                ("hang up", "lose database"),
            ),
        ),
        schedule=(Fault(at_s=12.459467, name="freeze", seed=3835830209),),
        says="lift was shown at # s, and press # was not recorded yet",
    ),
    # A report that a failing disk kept from saying what was dropped is made with the next one.
    Failure(
        seed=263341445,
        presses=3,
        chosen=Chosen(
            sloth_s=0.01,
            fps=9.0,
            outbox_mb=0.03,
            has_file=True,
            has_shadow=True,
            has_robot=True,
            meetings=(("fill disk", "lose power"), ("hang up", "step clock"), ("plc", "stop"), ("blind",)),
        ),
        schedule=(
            Fault(at_s=1.460029, name="fill disk", seed=3521881167),
            Fault(at_s=4.223694, name="relay", seed=2982378721),
            Fault(at_s=10.878587, name="bad disk", seed=1471247335),
        ),
        says="messages were dropped # s ago, and no alarm says so",
    ),
    # A clock that was set on a full disk ended the report, and the alarm of dropped messages came ten seconds later.
    Failure(
        seed=312,
        presses=4,
        chosen=Chosen(
            has_archive=False,
            sloth_s=0.03,
            outbox_mb=0.01,
            has_shadow=True,
            forgets=True,
            features=("reference_press", "snapshot"),
        ),
        schedule=(
            Fault(at_s=3.73337, name="lose database", seed=43944734),
            Fault(at_s=7.211835, name="fill disk", seed=961560960),
            Fault(at_s=12.956036, name="step clock", seed=658428292),
        ),
        says="messages were dropped # s ago, and no alarm says so",
    ),
    # A gel that was learnt while something pressed was corrected, and its light was not: the free gel was blind.
    Failure(
        seed=80068,
        presses=15,
        chosen=Chosen(
            brokers=2,
            sloth_s=0.01,
            fps=9.0,
            level="silent at 5",
            has_shadow=True,
            has_robot=True,
            plc="modbus",
            piece="free",
            forgets=True,
            features=("snapshot",),
            stamps_late=True,
        ),
        schedule=(
            Fault(at_s=1.525563, name="plc", seed=3084639186),
            Fault(at_s=3.965387, name="stop", seed=745466591),
            Fault(at_s=12.348396, name="kill", seed=594557085),
            Fault(at_s=17.087297, name="blind", seed=2391430470),
            Fault(at_s=20.882683, name="relearn", seed=3015153801),
            Fault(at_s=24.143162, name="replace gel", seed=3578390464),
            Fault(at_s=24.222819, name="relearn", seed=3050875041),
            Fault(at_s=26.976897, name="relearn", seed=4029625886),
            Fault(at_s=35.396299, name="relearn", seed=1147705227),
            Fault(at_s=38.651876, name="blind", seed=650469022),
            Fault(at_s=43.079692, name="lose database", seed=795747312),
            Fault(at_s=45.148032, name="blind", seed=3598528632),
            Fault(at_s=46.910721, name="relearn", seed=4070512387),
        ),
        says="the alarm device is still raised # s after its reason went",
    ),
    Failure(
        seed=1000,
        presses=20,
        chosen=Chosen(
            has_archive=False,
            sloth_s=0.03,
            fps=9.0,
            level="silent at 5",
            has_file=True,
            piece="fixed",
            meetings=(("hang up", "stop"), ("plc", "second plc"), ("blind",), ("kill",)),
            forgets=True,
            features=("snapshot",),
        ),
        schedule=(
            Fault(at_s=35.872612, name="relay", seed=1001757555),
            Fault(at_s=36.061523, name="request", seed=4274270137),
            Fault(at_s=36.134729, name="kill", seed=426094222),
            Fault(at_s=39.324766, name="kill", seed=3988038376),
            Fault(at_s=41.637088, name="slow disk", seed=3997260865),
        ),
        says="lift was shown at # s, and press # was not recorded yet",
    ),
    # A PLC's cable was out for less than a frame: the auditor of alarms had not seen that its reason began anew.
    Failure(
        seed=263341807,
        presses=2,
        chosen=Chosen(
            sloth_s=0.01,
            fps=7.0,
            has_file=True,
            plc="modbus",
            piece="fixed",
            meetings=(("fill disk", "replace gel"), ("hang up", "step clock"), ("plc", "stop"), ("blind",)),
            has_serial=True,
            features=("snapshot",),
        ),
        schedule=(
            Fault(at_s=3.815701, name="unplug", seed=3190417993),
            Fault(at_s=15.602361, name="plc", seed=2746741543),
        ),
        says="the alarm plc is still raised # s after its reason went",
    ),
    # The simulator had a person select a part in the middle of a turn, whose hang had just ended.
    Failure(
        seed=263341817,
        presses=6,
        chosen=Chosen(
            fps=9.0,
            outbox_mb=0.01,
            meetings=(
                ("plc", "unplug"),
                ("kill",),
                ("select part", "replace gel"),
                ("hang up", "lose database"),
            ),
            has_page=True,
            features=("snapshot",),
            stamps_late=True,
        ),
        schedule=(
            Fault(at_s=2.367138, name="hang", seed=4126656373),
            Fault(at_s=6.73688, name="unplug", seed=2607119129),
            Fault(at_s=7.276874, name="hang", seed=1927982599),
            Fault(at_s=9.52058, name="stop", seed=4057233361),
            Fault(at_s=11.272336, name="slow disk", seed=1517863880),
            Fault(at_s=17.256467, name="select part", seed=3937271371),
        ),
        says="press # is judged by bundle #f#c#e#, and told was dc#b",
    ),
    # A master piece was asked for while the station started, pressed unseen, and the next part was taken for it.
    Failure(
        seed=263341903,
        presses=11,
        chosen=Chosen(
            sloth_s=0.03,
            level="3.1.1",
            has_file=True,
            has_robot=True,
            meetings=(("select part", "stop"), ("silence",), ("kill",), ("fill disk", "replace gel")),
            has_serial=True,
            features=("reference_press", "overview"),
        ),
        schedule=(
            Fault(at_s=3.704022, name="stop", seed=1875825258),
            Fault(at_s=3.964155, name="damage", seed=748558161),
            Fault(at_s=8.83458, name="stop", seed=2036667293),
            Fault(at_s=12.483014, name="silence", seed=1715800347),
            Fault(at_s=15.571457, name="silence", seed=2845574931),
            Fault(at_s=23.154591, name="kill", seed=3100285627),
            Fault(at_s=23.293107, name="silence", seed=487149914),
            Fault(at_s=24.290052, name="silence", seed=2573175106),
            Fault(at_s=25.099357, name="reference_press", seed=1923024500),
        ),
        says="press # at # s is lost, without any fault",
    ),
    # A hang that was drawn before the last fault ended began after it, so frames waited when memory was counted.
    Failure(
        seed=14,
        presses=1,
        chosen=Chosen(),
        schedule=(Fault(at_s=3.558999984, name="hang", seed=7),),
        says="# of CameraFrame are in memory",
    ),
    # A loop that had hung recorded a press from the frames that waited, and the auditor took it for unseen.
    Failure(
        seed=35,
        presses=1,
        chosen=Chosen(),
        schedule=(Fault(at_s=3.0, name="hang", seed=35),),
        says="lift was shown at # s, and press none was not recorded yet",
    ),
    # A broker refused `info` in the middle of a connection: what it retained was not so, and no alarm said it.
    Failure(
        seed=1,
        presses=14,
        chosen=Chosen(),
        schedule=(
            Fault(at_s=3.0, name="hang up", seed=185),
            Fault(at_s=4.0, name="select part", seed=1),
        ),
        says="the alarm receiver is not raised # s after its reason came",
    ),
    # A bus gave in a burst what it had held, and then came broken frames: the auditors did not count what was seen.
    Failure(
        seed=5015,
        presses=22,
        chosen=Chosen(brokers=2, sloth_s=0.01, level="3.1.1", has_file=True, has_robot=True, until_next=True),
        schedule=(
            Fault(at_s=3.238514, name="freeze", seed=1430718302),
            Fault(at_s=22.131463, name="freeze", seed=2225678270),
            Fault(at_s=24.643802, name="freeze", seed=958445621),
            Fault(at_s=29.010671, name="hold back", seed=1347546086),
            Fault(at_s=29.147069, name="freeze", seed=3150616640),
            Fault(at_s=30.28446, name="damage", seed=996524367),
        ),
        says="nothing is seen for # s, and a pass is shown",
    ),
    # A page showed the pass of the part before a master piece, also to who had pressed a part in its place.
    Failure(
        seed=0,
        presses=3,
        chosen=Chosen(has_page=True, features=("reference_press",)),
        schedule=(Fault(at_s=6.5, name="reference_press", seed=1),),
        says="the page shows a pass of press #, and # came later",
    ),
    # A station that was started while its sensor was covered did not keep that time.
    Failure(
        seed=0,
        presses=3,
        chosen=Chosen(),
        schedule=(
            Fault(at_s=4.0, name="blind", seed=0),
            Fault(at_s=5.0, name="stop", seed=1),
            Fault(at_s=6.0, name="damage", seed=0),
        ),
        says="nothing was seen for long until # s, and that is not in the acts",
    ),
    # Marks on a gel went by themselves and were taken for a press; the next part over it was one press with it.
    Failure(
        seed=321,
        presses=20,
        chosen=Chosen(
            sloth_s=0.03,
            fps=9.0,
            has_serial=True,
            forgets=True,
            presses=24,
            features=("press_again",),
            is_slow=True,
            stamps_late=True,
        ),
        schedule=(
            Fault(at_s=26.151739, name="mark gel", seed=2),
            Fault(at_s=29.825938, name="stop", seed=2092692727),
        ),
        says="press # at # s is lost, without any fault",
    ),
    # The configuration was edited after a master piece was asked for, and nobody took that for a change: it is refused.
    Failure(
        seed=7100,
        presses=8,
        chosen=Chosen(
            has_shadow=True,
            is_lenient=True,
            meetings=(
                ("hang up", "lose database"),
                ("plc", "stop"),
                ("fill disk", "replace gel"),
                ("damage",),
            ),
            has_serial=True,
            features=("snapshot", "reference_press"),
        ),
        schedule=(
            Fault(at_s=2.816983, name="lose database", seed=2284622285),
            Fault(at_s=11.496789, name="edit configuration", seed=439540712),
            Fault(at_s=12.00307, name="stop", seed=1196716536),
            Fault(at_s=16.510341, name="reference_press", seed=3712302518),
            Fault(at_s=16.624465, name="edit configuration", seed=1334681753),
        ),
        says="press # is of the master piece, and has a result",
    ),
    # A cut shadow was whole for a second between two looks, and cut again: the alarm was awaited since before.
    Failure(
        seed=0,
        presses=8,
        chosen=Chosen(has_shadow=True),
        schedule=(
            Fault(at_s=2.3, name="break shadow", seed=1),
            Fault(at_s=11.8, name="break shadow", seed=1),
        ),
        says="the alarm shadow is not raised # s after its reason came",
    ),
    # A restart forgot that more sound parts fail than promised until the next press or word: its first look has no gel.
    Failure(
        seed=40026,
        presses=9,
        chosen=Chosen(
            sloth_s=0.03,
            level="silent at 5",
            has_shadow=True,
            has_heir=True,
            is_lenient=True,
            has_serial=True,
            forgets=True,
            presses=30,
            stamps_late=True,
        ),
        schedule=(
            Fault(at_s=2.283966, name="break tool", seed=268637018),
            Fault(at_s=11.691044, name="say", seed=3245015671),
            Fault(at_s=16.130382, name="say", seed=3239718648),
            Fault(at_s=16.181441, name="say", seed=3545962276),
            Fault(at_s=16.467537, name="say", seed=3345287276),
            Fault(at_s=17.625153, name="stop", seed=392181545),
        ),
        says="the alarm false_alarms is not raised # s after its reason came",
    ),
)
