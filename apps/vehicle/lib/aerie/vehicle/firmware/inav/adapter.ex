defmodule Aerie.Vehicle.Firmware.Inav.Adapter do
  @moduledoc "iNav, over MSP. Its session acknowledges a plan after it has read it."

  use Aerie.Vehicle.Firmware.Adapter

  use Aerie.Vehicle.Protocol.Mavlink.Commands,
    calibration: Aerie.Vehicle.Firmware.Msp.Commands,
    long_frames: []

  alias Aerie.Vehicle.Firmware.{Inav, Msp, Reading, Telemetry, Traits}
  alias Aerie.Vehicle.Protocol.Mavlink
  alias Aerie.Vehicle.Protocol.Mavlink.Streams

  @impl true
  def traits do
    %Traits{
      title: "iNav",
      vendor: "iNav",
      param_encoding: :bytewise,
      param_tables: :inav,
      # The gateway reads them one by one before it lists them; on a slow line that takes long.
      param_list_s: 60,
      command_line: ["INAV", "iNav"]
    }
  end

  @impl true
  def telemetry, do: %Telemetry{height_apart?: true, arming_texts?: true}

  @impl true
  def reading, do: %Reading{steered_by: :channels}

  @impl true
  def gap(type, _kind) when type in ~w(goto set_home), do: nil
  def gap(type, _kind), do: Msp.Commands.gap(type)

  @impl true
  def steps(%{type: "rtl"}, vehicle), do: Msp.Commands.mode("NAV RTH", vehicle)
  def steps(%{type: "hold"}, vehicle), do: Msp.Commands.mode("NAV POSHOLD", vehicle)

  def steps(%{type: "goto", params: %{altitude_reference: "terrain"}}, _vehicle),
    do: {:gap, "iNav has heights above home and above sea level"}

  def steps(%{type: "goto", params: %{speed: speed}}, _vehicle) when speed != nil,
    do: {:gap, "iNav flies there at its own speed (nav_auto_speed)"}

  def steps(%{type: "goto", params: params}, _vehicle) do
    frame = Streams.frame(params.altitude_reference)
    numbers = %{1 => -1, 2 => 0, 4 => params[:yaw] || :nan}
    place = {params.lat, params.lon}
    {:ok, [Mavlink.int(:MAV_CMD_DO_REPOSITION, [{frame, params.altitude}], place, numbers, answer_ms: 3_000)]}
  end

  def steps(command, vehicle), do: Msp.Commands.steps(command, vehicle)

  @impl true
  def plan_gap(0), do: nil
  def plan_gap(_fence_or_rally), do: "iNav has no fences or rally points over MSP"

  @impl true
  def kept(item, mission_type, _kind), do: Inav.StoredItem.kept(item, mission_type)
end
