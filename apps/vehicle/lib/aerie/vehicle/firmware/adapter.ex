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

      @impl true
      def traits, do: %Aerie.Vehicle.Firmware.Traits{}
      @impl true
      def telemetry, do: %Aerie.Vehicle.Firmware.Telemetry{}
      @impl true
      def reading, do: %Aerie.Vehicle.Firmware.Reading{}
      @impl true
      def ground_station(_kind), do: %Aerie.Vehicle.Firmware.GroundStation{}

      @impl true
      def gap(_type, _kind), do: "Aerie knows how to command ArduPilot and PX4, not this firmware"
      @impl true
      def steps(command, vehicle), do: {:error, gap(command.type, vehicle.kind)}
      @impl true
      def encode(_step, _attempt, _vehicle), do: []
      @impl true
      def cancel(_step, _vehicle), do: []
      @impl true
      def release(_step, _vehicle), do: []
      @impl true
      def read(_step, _message, _source, _vehicle), do: :ignore
      @impl true
      def listens(_step), do: []
      @impl true
      def setpoints_first?(_command, _vehicle), do: false
      @impl true
      def plan_gap(_mission_type), do: nil

      @impl true
      def home_is_item_0?, do: false
      @impl true
      def item_offset, do: -1
      @impl true
      def kept(_item, _mission_type, _kind), do: %{}
      @impl true
      def plan_watch_us(_mission_type), do: 0
      @impl true
      def plan_verdict(_message, _mission_type, _opaque_id), do: :ignore

      defoverridable unquote(__MODULE__)
      defoverridable Aerie.Vehicle.Protocol
      defoverridable Protocols.Mission.Firmware
    end
  end
end
