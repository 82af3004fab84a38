defmodule Aerie.Vehicle.Event do
  @moduledoc """
  Something that happened to a vehicle.

  The id is a function of the vehicle, the event's type, its place in the vehicle's sequence, its time and its data: the
  same transition found twice in the same bytes (a replay, a detector that was restored after a crash) has the same id,
  which lets every consumer, and JetStream by `Nats-Msg-Id`, drop the second one.
  """

  @enforce_keys [:id, :vehicle, :type, :seq, :time, :data]
  defstruct [:id, :vehicle, :type, :seq, :time, :vehicle_time_ms, :data]

  @typedoc """
  * `:id` - 32 hexadecimal digits, unique
  * `:vehicle` - the vehicle's public name
  * `:type` - one of `types/0`
  * `:seq` - 1, 2, 3 … per vehicle for as long as the gateway's store lives
  * `:time` - unix microseconds at which the gateway received what shows the event
  * `:vehicle_time_ms` - the vehicle's own clock (milliseconds since its boot) as last heard, or nil
  * `:data` - what there is to say, by `Aerie.Vehicle.EventTypes`; string keys, JSON values
  """
  @type t :: %__MODULE__{
          id: String.t(),
          vehicle: String.t(),
          type: String.t(),
          seq: pos_integer(),
          time: integer(),
          vehicle_time_ms: non_neg_integer() | nil,
          data: %{String.t() => term()}
        }

  @types Aerie.Vehicle.EventTypes.names()

  @doc "All event types; `Aerie.Vehicle.EventTypes` says what they mean."
  @spec types() :: [String.t()]
  def types, do: @types

  @doc "An event with its id."
  @spec new(String.t(), String.t(), pos_integer(), integer(), non_neg_integer() | nil, map()) :: t()
  def new(vehicle, type, seq, time, vehicle_time_ms, data) when type in @types do
    %__MODULE__{
      id: id(vehicle, type, seq, time, data),
      vehicle: vehicle,
      type: type,
      seq: seq,
      time: time,
      vehicle_time_ms: vehicle_time_ms,
      data: data
    }
  end

  defp id(vehicle, type, seq, time, data) do
    # The deterministic form keeps the id independent of the order in which a map's keys happen to be kept.
    digest = :crypto.hash(:sha256, :erlang.term_to_binary({vehicle, type, seq, time, data}, [:deterministic]))
    digest |> binary_part(0, 16) |> Base.encode16(case: :lower)
  end
end
