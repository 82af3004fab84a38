defmodule Aerie.EventLog do
  @moduledoc """
  Writes one line of the log for each thing that happens to a gateway and matters to the people who run it: links,
  vehicles, commands, desired states, recordings. It listens to `:telemetry` (`Aerie.Fleet.Telemetry`), so no part has
  to log for it; what a part logs itself, with more words, is not in the table here.

  What somebody could cause in a flood (refused commands) is a line once in five seconds for each cause.
  """

  require Logger

  alias Aerie.Base.{Names, Store}

  @quiet_ms 5_000

  # Event, level, message, metadata that is written.
  @lines [
    {[:aerie, :vehicle, :event], :info, "event", []},
    {[:aerie, :vehicle, :status], :info, "vehicle status", [:old, :new]},
    {[:aerie, :vehicle, :displaced], :warning, "vehicle displaced: it was lost and made room",
     [:network, :system, :by]},
    {[:aerie, :vehicle, :restart], :error, "the processes of a vehicle were restarted", [:network, :system]},
    {[:aerie, :link, :up], :info, "link up", [:network, :local]},
    {[:aerie, :link, :down], :warning, "link down", [:network, :reason]},
    {[:aerie, :link, :ended], :info, "link ended", [:network, :reason]},
    {[:aerie, :link, :added], :info, "link added", [:network]},
    {[:aerie, :link, :removed], :info, "link removed", [:network]},
    {[:aerie, :link, :peer_up], :debug, "link has a peer", [:peer]},
    {[:aerie, :link, :peer_down], :debug, "link lost a peer", [:peer, :reason]},
    {[:aerie, :identity, :silent], :error, "the gateway's heartbeat stops: some of its loops do not answer",
     []},
    {[:aerie, :identity, :answering], :info, "the gateway's heartbeat goes on", []},
    {[:aerie, :router, :carrier], :info, "another link carries", [:group]},
    {[:aerie, :router, :vehicle_refused], :warning, "vehicle refused", [:network, :system, :reason]},
    {[:aerie, :recorder, :opened], :info, "recording begins", [:target, :file]},
    {[:aerie, :recorder, :closed], :info, "recording ends", [:target, :file]},
    {[:aerie, :recorder, :removed], :info, "old recording removed", [:file]},
    {[:aerie, :policy, :refused], :notice, "command refused", [:type, :source, :rule]},
    {[:aerie, :command, :refused], :notice, "command refused", [:type, :source, :rule, :reason]},
    {[:aerie, :command, :done], :info, "command done", [:id, :type, :result, :reason]},
    {[:aerie, :shadow, :updated], :info, "desired state changed", [:actor, :via, :set, :removed]},
    {[:aerie, :shadow, :refused], :notice, "change of the desired state refused", [:actor, :via, :reason]}
  ]
  @floods [
    [:aerie, :router, :vehicle_refused],
    [:aerie, :policy, :refused],
    [:aerie, :command, :refused],
    [:aerie, :shadow, :refused]
  ]

  @doc "The events that are written, each with its level."
  @spec events() :: [{:telemetry.event_name(), Logger.level()}]
  def events, do: for({event, level, _message, _keys} <- @lines, do: {event, level})

  @doc """
  Writes the events of a gateway from now on. Attached again, it does nothing. `except`: events that somebody else
  shows.
  """
  @spec attach(Names.gateway(), except: [:telemetry.event_name()]) :: :ok
  def attach(gateway, options \\ []) do
    except = Keyword.get(options, :except, [])

    for {event, _level, _message, _keys} = line <- @lines, event not in except do
      _ = :telemetry.attach({__MODULE__, gateway, event}, event, &__MODULE__.handle/4, {gateway, line})
    end

    :ok
  end

  @doc "Ends `attach/2`."
  @spec detach(Names.gateway()) :: :ok
  def detach(gateway) do
    for {event, _level, _message, _keys} <- @lines, do: _ = :telemetry.detach({__MODULE__, gateway, event})
    :ok
  end

  @doc false
  @spec handle(:telemetry.event_name(), map(), map(), {Names.gateway(), tuple()}) :: :ok
  def handle(event, _measurements, %{gateway: gateway} = metadata, {gateway, {event, level, message, keys}}) do
    if event not in @floods or due?(gateway, {__MODULE__, event, cause(metadata)}) do
      Logger.log(level, message, [fields: fields(event, metadata, keys)] ++ subject(metadata))
    end

    :ok
  end

  # Another gateway of this VM.
  def handle(_event, _measurements, _metadata, _config), do: :ok

  defp due?(gateway, claim) do
    Store.claim(gateway, claim, @quiet_ms)
  rescue
    # The store is restarting. A handler that raises would be detached.
    ArgumentError -> true
  end

  # A tuple: ETS cannot replace what has a map as its key.
  defp cause(m), do: {m[:source] || m[:actor], m[:rule] || m[:reason], m[:network]}

  defp subject(metadata), do: for(key <- [:gateway, :link, :vehicle], value = metadata[key], do: {key, value})

  defp fields([:aerie, :vehicle, :event], %{event: event}, _keys) do
    at = event.time |> DateTime.from_unix!(:microsecond) |> DateTime.truncate(:millisecond)
    [type: event.type, at: DateTime.to_iso8601(at)] ++ Enum.sort(event.data)
  end

  defp fields(_event, metadata, keys), do: for(key <- keys, do: {key, metadata[key]})
end
