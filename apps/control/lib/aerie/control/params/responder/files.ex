defmodule Aerie.Control.Params.Responder.Files do
  @moduledoc """
  ArduPilot's parameter file, served to ground stations by MAVLink FTP from a list that is known to be the vehicle's, as the vehicle serves it
  (`MavCodec.Ftp.PackedParams`). Pure.

  A station's session lasts until it ends it or opens another file, or until the list may be wrong: then its next read is refused, and it
  begins again. Sessions have the number of the request, and only that station's requests with this number are answered.
  """

  alias Aerie.Control.Params.{Param, Table}
  alias MavCodec.Ftp.Packet
  alias MavCodec.Ftp.PackedParams
  alias Protocols.Files.Content

  @max_sessions 64
  @files %{PackedParams.path(false) => false, PackedParams.path(true) => true}

  defstruct sessions: %{}

  @typedoc "By station: number, file (nil once its list may be wrong), and the last answer"
  @type t :: %__MODULE__{sessions: %{term() => map()}}

  @doc "Classifies a station's request: open the file, a request of an open session, or neither."
  @spec request(struct()) :: {:open, Packet.t()} | {:more, Packet.t()} | :other
  def request(message) do
    with {:ok, packet} <- Packet.request(message),
         operation when operation in [:open, :read, :burst, :terminate] <- Packet.operation(packet),
         true <- operation != :open or is_map_key(@files, packet.data) do
      {if(operation == :open, do: :open, else: :more), packet}
    else
      _none -> :other
    end
  end

  @doc "A station opens the file of a list; `:full` if too many have."
  @spec open(t(), station :: term(), Packet.t(), Table.t()) :: {[Packet.t()], t()} | :full
  def open(%{sessions: sessions}, station, _packet, _table)
      when map_size(sessions) >= @max_sessions and not is_map_key(sessions, station),
      do: :full

  def open(served, station, packet, table) do
    params = for name <- table.order, do: Param.pack(table.params[name])
    content = Content.made(&PackedParams.encode(params, Map.fetch!(@files, packet.data), &1))
    answer = %{Packet.ack(packet, <<Content.size(content)::little-32>>) | offset: 0}
    session = %{number: packet.session, content: content, last: {packet, [answer]}}

    {[answer], put_in(served.sessions[station], session)}
  end

  @doc "Whether this is a request in a session of that station here."
  @spec ours?(t(), station :: term(), Packet.t()) :: boolean()
  def ours?(served, station, packet),
    do: match?(%{^station => %{number: number}} when number == packet.session, served.sessions)

  @doc "The answers to a request in a station's session."
  @spec more(t(), station :: term(), Packet.t()) :: {[Packet.t()], t()}
  def more(served, station, packet) do
    case Map.fetch!(served.sessions, station) do
      # A repetition gets the same answer (T2).
      %{last: {^packet, answers}} ->
        {answers, served}

      session ->
        {answers, session} = act(session, Packet.operation(packet), packet)
        session = session && %{session | last: {packet, answers}}
        {answers, %{served | sessions: put(served.sessions, station, session)}}
    end
  end

  @doc "A station opened something else."
  @spec ended(t(), station :: term()) :: t()
  def ended(served, station), do: %{served | sessions: Map.delete(served.sessions, station)}

  @doc "The list may be wrong from now on."
  @spec stale(t()) :: t()
  def stale(served),
    do: %{
      served
      | sessions: Map.new(served.sessions, fn {station, s} -> {station, %{s | content: nil, last: nil}} end)
    }

  defp put(sessions, station, nil), do: Map.delete(sessions, station)
  defp put(sessions, station, session), do: %{sessions | station => session}

  defp act(_session, :terminate, packet), do: {[Packet.ack(packet, "")], nil}
  # Not the vehicle: the number may be that of another session there.
  defp act(%{content: nil} = session, _read, packet), do: {[Packet.nak(packet, :failed)], session}

  defp act(session, _read, packet) do
    case Content.answers(session.content, packet, :short) do
      {:ok, answers, content} -> {answers, %{session | content: content}}
      :error -> {[Packet.nak(packet, :failed)], session}
    end
  end
end
