defmodule Aerie.Fleet.Bridge.Message do
  @moduledoc """
  Subjects and bodies of the NATS contract. Pure.

      fleet.{environment}.{vehicle}.state.{group}   {"vehicle","group","gateway","epoch","time","time_boot_ms","data"}
      fleet.{environment}.{vehicle}.event.{type}    {"id","vehicle","type","epoch","seq","time","time_boot_ms","data"}

  `epoch` is a number that grows with each start of the gateway. A new one means that the gateway was restarted and that
  `seq` begins at 1 again. Text made from a recording has no epoch.
  `gateway` is the name of the one that published it: two may hear the same vehicle.
  Times are ISO 8601 in UTC with milliseconds. A number that JSON cannot express (NaN, infinity) is null.
  """

  alias Aerie.Base.Json
  alias Aerie.Fleet.Bridge.Events.Gaps
  alias Aerie.Vehicle.Event
  alias Aerie.Vehicle.State.Fields

  @max_state_bytes 32_768

  @doc "The largest body of a state group that streams and readers take."
  @spec max_state_bytes() :: pos_integer()
  def max_state_bytes, do: @max_state_bytes

  @doc """
  The groups of a vehicle's state, the last tokens of its subjects. What a gateway says of a vehicle is also one
  (`Aerie.Fleet.Remote`).
  """
  @spec state_groups() :: [String.t()]
  def state_groups,
    do: for({group, _title, _fields} <- Fields.all(), do: Atom.to_string(group)) ++ ["gateway"]

  @doc "The types of events, of a vehicle or of a gateway."
  @spec event_types() :: [String.t()]
  def event_types, do: Event.Types.names() ++ [Gaps.type()]

  @doc "Whether a subject is that of an event that there is."
  @spec event?(String.t()) :: boolean()
  def event?(subject) do
    case String.split(subject, ".", parts: 5) do
      ["fleet", _environment, _vehicle, "event", type] -> type in event_types()
      _other -> false
    end
  end

  @doc "Subject of a state group."
  @spec state_subject(String.t(), String.t(), String.t()) :: String.t()
  def state_subject(environment, vehicle, group), do: "fleet.#{environment}.#{vehicle}.state.#{group}"

  @doc "Subject of an event. A type with a dot (`battery.low`) is two tokens of the subject."
  @spec event_subject(String.t(), Event.t() | %{vehicle: String.t(), type: String.t()}) :: String.t()
  def event_subject(environment, event), do: "fleet.#{environment}.#{event.vehicle}.event.#{event.type}"

  @typedoc "Which start of which gateway publishes."
  @type origin :: %{epoch: pos_integer() | nil, gateway: String.t() | nil}

  @doc "Body of a state group; `at` in unix microseconds. Text made from a recording has no origin."
  @spec state(String.t(), String.t(), map(), non_neg_integer() | nil, integer(), origin() | nil) ::
          String.t()
  def state(vehicle, group, data, time_boot_ms, at, origin \\ nil) do
    IO.iodata_to_binary([
      ~s({"data":),
      Json.encode_to_iodata!(Fields.plain(group, data)),
      origin(origin),
      ~s(,"group":"),
      group,
      ~s(","time":"),
      Json.time(at),
      ~s(","time_boot_ms":),
      Json.encode_to_iodata!(time_boot_ms),
      ~s(,"vehicle":),
      Json.encode_to_iodata!(vehicle),
      ?}
    ])
  end

  defp origin(nil), do: []
  defp origin(%{epoch: nil, gateway: gateway}), do: [~s(,"gateway":), Json.encode_to_iodata!(gateway)]

  defp origin(%{epoch: epoch} = origin),
    do: [~s(,"epoch":), Integer.to_string(epoch) | origin(%{origin | epoch: nil})]

  @doc "Body of an event."
  @spec event(Event.t(), pos_integer() | nil) :: String.t()
  def event(%Event{} = event, epoch \\ nil), do: event |> Fields.event(epoch) |> Json.encode!()
end
