defmodule Aerie.Bridge.Message do
  @moduledoc """
  Subjects and bodies of the NATS contract. Pure.

      fleet.{environment}.{vehicle}.state.{group}   {"vehicle","group","time","time_boot_ms","data"}
      fleet.{environment}.{vehicle}.event.{type}    {"id","vehicle","type","seq","time","vehicle_time_ms","data"}

  Times are ISO 8601 in UTC with milliseconds. A number that JSON has no form for (NaN, infinity) is null.
  """

  alias Aerie.Vehicle.Event

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
      "time" => time(at),
      "time_boot_ms" => time_boot_ms,
      "data" => plain(data)
    })
  end

  @doc "Body of an event."
  @spec event(Event.t()) :: String.t()
  def event(%Event{} = event) do
    JSON.encode!(%{
      "id" => event.id,
      "vehicle" => event.vehicle,
      "type" => event.type,
      "seq" => event.seq,
      "time" => time(event.time),
      "vehicle_time_ms" => event.vehicle_time_ms,
      "data" => plain(event.data)
    })
  end

  defp time(us),
    do: us |> DateTime.from_unix!(:microsecond) |> DateTime.truncate(:millisecond) |> DateTime.to_iso8601()

  defp plain(map) when is_map(map) and not is_struct(map),
    do: Map.new(map, fn {key, value} -> {key, plain(value)} end)

  defp plain(list) when is_list(list), do: Enum.map(list, &plain/1)
  defp plain(odd) when odd in [:nan, :infinity, :neg_infinity], do: nil
  defp plain({:nan, _bits}), do: nil

  # Text of a vehicle (STATUSTEXT, a parameter's name) is whatever bytes it sent.
  defp plain(text) when is_binary(text),
    do: if(String.valid?(text), do: text, else: String.replace_invalid(text))

  defp plain(value), do: value
end
