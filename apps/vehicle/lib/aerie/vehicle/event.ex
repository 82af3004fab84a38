defmodule Aerie.Vehicle.Event do
  @moduledoc """
  Something that happened to a vehicle.

  The id is a hash of the vehicle, the type, the sequence number, the time and the data. The same transition detected twice
  in the same bytes (a replay, a detector that was restored after a crash) has the same id, so that every consumer, and
  JetStream by `Nats-Msg-Id`, can drop the second one.
  """

  @enforce_keys [:id, :vehicle, :type, :seq, :time, :data]
  defstruct [:id, :vehicle, :type, :seq, :time, :vehicle_time_ms, :data]

  @typedoc """
  * `:id` - 32 hexadecimal digits, unique
  * `:vehicle` - the vehicle's public name
  * `:type` - one of `Aerie.Vehicle.Event.Types`
  * `:seq` - 1, 2, 3 … per vehicle, for the lifetime of the gateway's store
  * `:time` - unix microseconds at which the gateway received what shows the event
  * `:vehicle_time_ms` - the vehicle's own clock (milliseconds since its boot) as last heard, or nil
  * `:data` - the fields of the type (`Aerie.Vehicle.Event.Types`); string keys, JSON values
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

  @types Aerie.Vehicle.Event.Types.names()

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
    # Without :deterministic, the hash would depend on the internal order of a map's keys.
    digest = :crypto.hash(:sha256, :erlang.term_to_binary({vehicle, type, seq, time, data}, [:deterministic]))
    digest |> binary_part(0, 16) |> Base.encode16(case: :lower)
  end
end
