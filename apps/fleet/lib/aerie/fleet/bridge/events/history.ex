defmodule Aerie.Fleet.Bridge.Events.History do
  @moduledoc """
  The events of the whole fleet in a span of time: from the stream, so that they are there after a restart, and from the
  journal, which has those of this run that are not stored yet. Without NATS the journal's alone. It reads in the
  process that asks.
  """

  alias Aerie.Base.Names
  alias Aerie.Fleet.Nats
  alias Aerie.Fleet.Nats.{JetStream, Reader}
  alias Aerie.Vehicle.Event
  alias Aerie.Vehicle.Events.Journal

  @max_events 20_000
  # At a hub with a stream for each vehicle.
  @max_streams 256

  @typedoc "`cut`: older events of the span that were left out; `problem`: why the stream could not be read."
  @type t :: %{events: [Event.t()], cut: non_neg_integer(), problem: String.t() | nil}

  @doc """
  The events from one time to another (unix microseconds), the newest first. `nats`: the connection, nil while there is
  none, and the subjects of events; or `:off`.
  """
  @spec read(Names.gateway(), :off | {pid() | nil, String.t()}, from :: integer(), to :: integer()) :: t()
  def read(gateway, nats, from, to) do
    recent = Journal.recent(gateway, :all, limit: @max_events, since: from)
    {stored, cut, problem} = stored(nats, from)

    events =
      for event <- stored ++ recent, event.time >= from and event.time <= to, uniq: true, do: event

    events = events |> Enum.uniq_by(& &1.id) |> Enum.sort_by(&{&1.time, &1.vehicle, &1.seq}, :desc)
    %{events: events, cut: cut, problem: problem}
  end

  # An event is stored when it happens or later, so its span may be read from its beginning on.
  defp stored(:off, _from), do: {[], 0, nil}
  defp stored({nil, _subjects}, _from), do: {[], 0, "there is no connection to NATS"}

  defp stored({conn, subjects}, from) do
    case streams(conn, subjects) do
      {:ok, streams} ->
        share = div(@max_events, max(length(streams), 1))
        Enum.reduce(streams, {[], 0, nil}, &stream(conn, &1, subjects, from, share, &2))

      {:error, reason} ->
        {[], 0, words(reason)}
    end
  end

  defp streams(conn, subjects) do
    body = JSON.encode!(%{subject: subjects})

    with {:ok, %{"streams" => names}} <- JetStream.ask(conn, "$JS.API.STREAM.NAMES", body),
         do: {:ok, Enum.take(names || [], @max_streams)},
         else: (
           {:ok, _none} -> {:ok, []}
           error -> error
         )
  end

  # Each message is taken in this process, one after the other.
  defp stream(conn, stream, subjects, from, share, {events, cut, problem}) do
    mine = make_ref()
    caller = self()
    told = &with({:ok, event} <- event(IO.iodata_to_binary(&1.body)), do: send(caller, {mine, event}))

    case Reader.since(conn, stream, subjects, from, share, told) do
      {:ok, more} -> {taken(mine, events), cut + more, problem}
      {:error, reason} -> {taken(mine, events), cut, words(reason)}
    end
  end

  defp taken(mine, events) do
    receive do
      {^mine, event} -> taken(mine, [event | events])
    after
      0 -> events
    end
  end

  defp words(%{"description" => text}), do: text
  defp words(reason), do: Nats.text(reason)

  @doc "An event as NATS has it; `:error` for anything else, such as events of gateways."
  @spec event(binary()) :: {:ok, Event.t()} | :error
  def event(body) do
    with {:ok, %{"id" => id, "vehicle" => vehicle, "type" => type, "seq" => seq, "time" => time} = shown} <-
           JSON.decode(body),
         true <-
           is_binary(id) and is_binary(vehicle) and is_binary(type) and is_integer(seq) and is_binary(time),
         true <- type in Event.Types.names(),
         {:ok, time, _offset} <- DateTime.from_iso8601(time),
         data when is_map(data) <- Map.get(shown, "data", %{}) do
      {:ok,
       %Event{
         id: id,
         vehicle: vehicle,
         type: type,
         seq: seq,
         time: DateTime.to_unix(time, :microsecond),
         vehicle_time_ms: shown["time_boot_ms"],
         data: data
       }}
    else
      _other -> :error
    end
  end
end
