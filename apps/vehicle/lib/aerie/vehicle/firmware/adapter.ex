defmodule Aerie.Vehicle.Firmware.Adapter do
  @moduledoc """
  A firmware: commands (`Aerie.Vehicle.Protocol`), plans (`Protocols.Mission.Firmware`), and facts as data. `use` it for
  defaults of all of these, which count for a firmware that is not known as well: it gets no commands, and in everything
  else it is the one that can hurt.
  """

  alias Aerie.Vehicle.Firmware.{GroundStation, Reading, Telemetry, Traits}

  @doc "What it is and what it offers."
  @callback traits() :: Traits.t()

  @doc "Where its messages say other things than MAVLink declares."
  @callback telemetry() :: Telemetry.t()

  @doc "How it reads what is sent to it."
  @callback reading() :: Reading.t()

  @doc "Which ground station keeps the failsafe of a kind of vehicle quiet."
  @callback ground_station(kind :: String.t()) :: GroundStation.t()

  @doc false
  defmacro __using__([]) do
    quote do
      @behaviour unquote(__MODULE__)
      @behaviour Aerie.Vehicle.Protocol
      @behaviour Protocols.Mission.Firmware

      def traits, do: %Aerie.Vehicle.Firmware.Traits{}
      def telemetry, do: %Aerie.Vehicle.Firmware.Telemetry{}
      def reading, do: %Aerie.Vehicle.Firmware.Reading{}
      def ground_station(_kind), do: %Aerie.Vehicle.Firmware.GroundStation{}

      def gap(_type, _kind), do: "Aerie knows how to command ArduPilot and PX4, not this firmware"
      def steps(command, vehicle), do: {:error, gap(command.type, vehicle.kind)}
      def encode(_step, _attempt, _vehicle), do: []
      def cancel(_step, _vehicle), do: []
      def release(_step, _vehicle), do: []
      def read(_step, _message, _source, _vehicle), do: :ignore
      def listens(_step), do: []
      def setpoints_first?(_command, _vehicle), do: false
      def plan_gap(_mission_type), do: nil

      def home_is_item_0?, do: false
      def item_offset, do: -1
      def kept(_item, _mission_type, _kind), do: %{}
      def plan_watch_us(_mission_type), do: 0
      def plan_verdict(_message, _mission_type, _opaque_id), do: :ignore

      defoverridable unquote(__MODULE__)
      defoverridable Aerie.Vehicle.Protocol
      defoverridable Protocols.Mission.Firmware
    end
  end
end
