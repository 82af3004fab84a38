defmodule Aerie.Vehicle.Firmware.Betaflight.Adapter do
  @moduledoc "Betaflight, over MSP."

  use Aerie.Vehicle.Firmware.Adapter

  use Aerie.Vehicle.Protocol.Mavlink.Commands,
    calibration: Aerie.Vehicle.Firmware.Msp.Commands,
    long_frames: []

  alias Aerie.Vehicle.Firmware.{Msp, Reading, Telemetry, Traits}

  @impl true
  def traits do
    %Traits{
      title: "Betaflight",
      vendor: "Betaflight",
      param_encoding: :bytewise,
      param_tables: :betaflight,
      # The gateway reads them one by one before it lists them; on a slow line that takes long.
      param_list_s: 60,
      command_line: ["Betaflight"]
    }
  end

  @impl true
  def telemetry, do: %Telemetry{height_apart?: true, arming_texts?: true}

  @impl true
  def reading, do: %Reading{steered_by: :channels}

  @impl true
  def gap(type, _kind) when type in ~w(goto set_home), do: "Betaflight has no message for it in MSP"
  def gap(type, _kind), do: Msp.Commands.gap(type)

  @impl true
  def steps(%{type: "rtl"}, vehicle), do: Msp.Commands.mode("GPS RESCUE", vehicle)
  def steps(%{type: "hold"}, vehicle), do: Msp.Commands.mode("POS HOLD", vehicle)
  def steps(command, vehicle), do: Msp.Commands.steps(command, vehicle)

  @impl true
  def plan_gap(_mission_type), do: "Betaflight has no missions, fences or rally points"
end
