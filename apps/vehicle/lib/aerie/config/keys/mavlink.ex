defmodule Aerie.Config.Keys.Mavlink do
  @moduledoc "What the gateway is on MAVLink: its ids, heartbeat, streams and dialects."

  import Aerie.Config.Field, only: [field: 4, section: 3]

  alias Aerie.Config.{Field, Types}

  @hub elem(Aerie.Identity.default_ids(), 0)
  @component elem(Aerie.Identity.default_ids(), 1)

  @doc "The section `mavlink`."
  @spec section() :: Field.t()
  def section do
    section(:mavlink, "The MAVLink side.", [
      field(
        :local_addr,
        Types.listen_address(),
        """
        UDP address on which vehicles and routers call in; off for none. Left out: ":14550", unless links are given.
        """,
        example: ~S(":14550")
      ),
      field(
        :system_id,
        Types.system_id(),
        """
        System id of this gateway. Companion (vehicle_id given): the vehicle's own, 1 if left out; auto: that of the one
        autopilot that is heard within three seconds of the first heartbeat. Hub: one from the top, #{@hub} if left out. 255 is
        the ground station's: refused without i_am_the_gcs.
        """,
        example: "#{@hub}"
      ),
      field(
        :component_id,
        {:integer, 1, 255},
        """
        Component id of this gateway. 191 is the on-board computer. 1 is the autopilot's: 191 is taken in its place.
        """,
        default: @component
      ),
      field(
        :i_am_the_gcs,
        :boolean,
        """
        This gateway stands for the operator's ground station: its heartbeat may keep a vehicle's ground-station failsafe
        quiet. Only where losing this gateway means that the operator is lost too. Allows system_id 255 and heartbeat_type
        gcs.
        """,
        default: false
      ),
      field(
        :heartbeat,
        :boolean,
        """
        Send a heartbeat once a second to each vehicle, as long as all loops of the gateway answer.
        """,
        default: true
      ),
      field(
        :heartbeat_type,
        {:enum, [:onboard_controller, :gcs]},
        """
        What the heartbeat says we are. PX4 takes any heartbeat of a gcs for its operator's. Left out: onboard_controller,
        or gcs with i_am_the_gcs.
        """,
        example: "onboard_controller"
      ),
      field(
        :heartbeat_deadman_s,
        {:number, 0.5, 60},
        """
        No heartbeat goes out while a loop that it stands for has not answered for this long.
        """,
        default: 3.0
      ),
      field(
        :request_streams,
        :boolean,
        """
        Ask vehicles for state messages that do not come by themselves, and for what clients want.
        """,
        default: true
      ),
      field(
        :streams,
        {:map, {:number, 0, 400}},
        """
        Messages that every vehicle is to send at least this often (per second), by their names.
        """,
        default: %{},
        example: "{ATTITUDE: 10, GLOBAL_POSITION_INT: 5}"
      ),
      field(
        :timesync_s,
        {:number, 0, 3600},
        "Time between two measurements of a vehicle's clock (TIMESYNC); 0: none.",
        default: 10.0
      ),
      field(
        :read_gcs_parameters,
        :boolean,
        """
        Read once from each vehicle which ground station its failsafe listens to (a handful of parameters).
        """,
        default: true
      ),
      field(
        :dialects,
        {:list, {:enum, [:all, :upstream, :ardupilot, :common]}},
        """
        Message definitions that are understood: all, upstream (PX4), ardupilot, common.
        """,
        default: [:all]
      ),
      field(:sysid32, :boolean, "Understand frames with 32-bit system ids (a draft of the standard).",
        default: false
      )
    ])
  end
end
