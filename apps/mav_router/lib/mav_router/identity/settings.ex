defmodule MavRouter.Identity.Settings do
  @moduledoc "Who the gateway is: its network, its ids on MAVLink, its heartbeat."
  use Aerie.Base.Settings

  import Aerie.Base.Settings.Rules

  alias Aerie.Base.Settings.Types

  section ""

  setting :vehicle_id,
          Types.token(),
          """
          Companion: the public name of the one vehicle aboard which this gateway runs; it is the vehicle with system id
          mavlink.system_id on the default network. Hub: leave it out and name vehicles under vehicles.
          """,
          example: "VID-001"

  setting :network, Types.token(), "The network of links and vehicles that name none.",
    default: MavRouter.Identity.default_network()

  section "mavlink"

  setting :system_id,
          Types.system_id(),
          """
          System id of this gateway. Companion (vehicle_id given): the vehicle's own, 1 if left out; auto: that of the one
          autopilot that is heard within three seconds of the first heartbeat. Hub: one from the top, #{hub()} if left out. 255 is
          the ground station's: refused without i_am_the_gcs.
          """,
          example: "#{hub()}"

  setting :component_id,
          {:integer, 1, 255},
          """
          Component id of this gateway. 191 is the on-board computer. 1 is the autopilot's: 191 is taken in its place.
          """,
          default: component()

  setting :i_am_the_gcs,
          :boolean,
          """
          This gateway stands for the operator's ground station: its heartbeat may keep a vehicle's ground-station failsafe
          quiet. Only where losing this gateway means that the operator is lost too. Allows system_id 255 and heartbeat_type
          gcs.
          """,
          default: false

  setting :heartbeat,
          :boolean,
          """
          Send a heartbeat once a second to each vehicle, as long as all loops of the gateway answer.
          """,
          default: true

  setting :heartbeat_type,
          {:enum, [:onboard_controller, :gcs]},
          """
          What the heartbeat says we are. PX4 takes any heartbeat of a gcs for its operator's. Left out: onboard_controller,
          or gcs with i_am_the_gcs.
          """,
          example: "onboard_controller"

  setting :deadman_ms,
          {:number, 0.5, 60},
          """
          No heartbeat goes out while a loop that it stands for has not answered for this long.
          """,
          key: "heartbeat_deadman_s",
          default: 3.0,
          times: 1000

  defp hub, do: elem(MavRouter.Identity.default_ids(), 0)
  defp component, do: elem(MavRouter.Identity.default_ids(), 1)

  @doc "Fills in what is left out; frames of an autopilot with our own ids would be taken for echoes of ours, so 1 is 191."
  @impl Aerie.Base.Settings
  def derive(settings) do
    %{
      settings
      | system_id: settings.system_id || if(settings.vehicle_id, do: 1, else: hub()),
        component_id: if(settings.component_id == 1, do: component(), else: settings.component_id),
        heartbeat_type:
          settings.heartbeat_type || if(settings.i_am_the_gcs, do: :gcs, else: :onboard_controller)
    }
  end

  # A hub belongs to no vehicle whose id it could take.
  @impl Aerie.Base.Settings
  def problems(%{vehicle_id: nil, mavlink: %{system_id: :auto}}) do
    hint = "auto takes the id of the vehicle that this gateway is aboard of; a hub has one of its own"
    [problem(["mavlink", "system_id"], "a number, or vehicle_id beside it", "auto", hint)]
  end

  # A heartbeat that a vehicle takes for its operator's hides that the operator is gone (H5).
  def problems(%{mavlink: %{i_am_the_gcs: true}}), do: []

  def problems(%{mavlink: mavlink}) do
    hint =
      "a vehicle's failsafe would take this gateway's heartbeat for the operator's; " <>
        "give mavlink.i_am_the_gcs: true if it is meant to stand for the ground station"

    [
      {mavlink.system_id == 255, ["mavlink", "system_id"],
       "an id that no ground station uses, such as #{hub()}", "255"},
      {mavlink.heartbeat_type == :gcs, ["mavlink", "heartbeat_type"], "onboard_controller", "gcs"}
    ]
    |> failed()
    |> Enum.map(&%{&1 | hint: hint})
  end
end
