defmodule Aerie.FifthFirmware.Adapter do
  @moduledoc "A firmware that Aerie does not have, as somebody would add it: see `Aerie.Gate.FirmwareTest`."

  use Aerie.Vehicle.Firmware.Adapter
  use Aerie.Vehicle.Protocol.Mavlink.Commands, calibration: __MODULE__.Calibration, long_frames: []

  alias Aerie.FifthFirmware.Modes
  alias Aerie.Vehicle.Firmware.{Reading, Telemetry, Traits}
  alias Aerie.Vehicle.Protocol.Mavlink.Commands
  alias MavCodec.Enums.MavAutopilot

  @impl true
  def traits do
    %Traits{
      title: "Fifth",
      mav_autopilot: MavAutopilot.value(:MAV_AUTOPILOT_AUTOQUAD),
      modes: Modes,
      param_encoding: :bytewise
    }
  end

  @impl true
  def telemetry, do: %Telemetry{rssi_full: 10}

  @impl true
  def reading, do: %Reading{long_height: :msl, steered_by: :commands}

  @impl true
  def gap("arm", _kind), do: nil
  def gap(_type, _kind), do: "Fifth only arms"

  @impl true
  def steps(%{type: type, params: params}, vehicle), do: {:ok, Commands.steps(type, params, vehicle)}

  defmodule Calibration do
    @moduledoc false
    def read(_step, _message, _source, _vehicle), do: :ignore
    def listens(_step), do: []
  end
end
