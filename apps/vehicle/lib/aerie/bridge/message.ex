defmodule Aerie.Bridge.Message do
  @moduledoc """
  Subjects and bodies of the NATS contract. Pure.

      fleet.{environment}.{vehicle}.state.{group}   {"vehicle","group","time","time_boot_ms","data"}
      fleet.{environment}.{vehicle}.event.{type}    {"id","vehicle","type","seq","time","time_boot_ms","data"}

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
  @spec state(String.t(), String.t(), map(), non_neg_integer() | nil, integer()) :: String.t()
  def state(vehicle, group, data, time_boot_ms, at) do
    JSON.encode!(%{
      "vehicle" => vehicle,
      "group" => group,
      "time" => Json.time(at),
      "time_boot_ms" => time_boot_ms,
      "data" => Json.plain(Fields.rounded(group, data))
    })
  end

  @doc "Body of an event."
  @spec event(Event.t()) :: String.t()
  def event(%Event{} = event), do: JSON.encode!(event_object(event))

  @doc "What the body of an event says: REST has the same."
  @spec event_object(Event.t()) :: map()
  def event_object(%Event{} = event) do
    %{
      "id" => event.id,
      "vehicle" => event.vehicle,
      "type" => event.type,
      "seq" => event.seq,
      "time" => Json.time(event.time),
      "time_boot_ms" => event.vehicle_time_ms,
      "data" => Json.plain(Fields.event(event.data))
    }
  end
end
