defmodule Aerie.Bridge.Message do
  @moduledoc """
  Subjects and bodies of the NATS contract. Pure.

      fleet.{environment}.{vehicle}.state.{group}   {"vehicle","group","epoch","time","time_boot_ms","data"}
      fleet.{environment}.{vehicle}.event.{type}    {"id","vehicle","type","epoch","seq","time","time_boot_ms","data"}

  `epoch` is the number of the gateway's life, greater with each start: another one means that the gateway was started
  anew, and that `seq` begins at 1. What comes from no gateway (a recording turned into text) has none.
  Times are ISO 8601 in UTC with milliseconds. A number that JSON has no form for (NaN, infinity) is null.
  """

  alias Aerie.Fleet.Json
  alias Aerie.Vehicle.{Event, Fields}

  @doc "Subject of a state group."
  @spec state_subject(String.t(), String.t(), String.t()) :: String.t()
  def state_subject(environment, vehicle, group), do: "fleet.#{environment}.#{vehicle}.state.#{group}"

  @doc "Subject of an event. A type with a dot (`battery.low`) takes two words, as consumers expect."
  @spec event_subject(String.t(), Event.t()) :: String.t()
  def event_subject(environment, event), do: "fleet.#{environment}.#{event.vehicle}.event.#{event.type}"

  @doc "Body of a state group; `at` in unix microseconds."
  @spec state(String.t(), String.t(), map(), non_neg_integer() | nil, integer(), pos_integer() | nil) ::
          String.t()
  def state(vehicle, group, data, time_boot_ms, at, epoch \\ nil) do
    body = %{
      "vehicle" => vehicle,
      "group" => group,
      "time" => Json.time(at),
      "time_boot_ms" => time_boot_ms,
      "data" => Json.plain(Fields.rounded(group, data))
    }

    epoch |> with_epoch(body) |> JSON.encode!()
  end

  @doc "Body of an event."
  @spec event(Event.t(), pos_integer() | nil) :: String.t()
  def event(%Event{} = event, epoch \\ nil), do: event |> event_object(epoch) |> JSON.encode!()

  @doc "What the body of an event says: REST has the same."
  @spec event_object(Event.t(), pos_integer() | nil) :: map()
  def event_object(%Event{} = event, epoch) do
    with_epoch(epoch, %{
      "id" => event.id,
      "vehicle" => event.vehicle,
      "type" => event.type,
      "seq" => event.seq,
      "time" => Json.time(event.time),
      "time_boot_ms" => event.vehicle_time_ms,
      "data" => Json.plain(Fields.event(event.data))
    })
  end

  defp with_epoch(nil, body), do: body
  defp with_epoch(epoch, body), do: Map.put(body, "epoch", epoch)
end
