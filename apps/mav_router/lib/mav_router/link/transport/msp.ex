defmodule MavRouter.Link.Transport.Msp do
  @moduledoc """
  A flight controller that speaks MSP (Betaflight, iNav) at another transport: `msp:auto`, `msp:/dev/ttyACM0,115200`, `msp:tcp:HOST:PORT`. `Msp.Session`
  asks it and speaks MAVLink in its place, so for the link and everything behind it a MAVLink vehicle is there.

  Its MAVLink id is the option `sysid`; without it a number from 100 to 199 that follows from the link's id. The option `share` is a port, or an address with
  one, where other programs speak MSP with it (`MavRouter.Link.Transport.Msp.Share`).

  A recording of the link also has what the session was given and wrote (`MavCodec.Msp.Trace`), from which `aerie msp` shows the line, and `Msp.Rerun` makes the
  same MAVLink frames again.
  """
  @behaviour MavRouter.Link.Transport

  alias MavRouter.Link.Transport
  alias Aerie.Base.Net.Address
  alias MavRouter.Link.Transport.{Form, Serial, TcpClient}
  alias MavRouter.Link.Transport.Msp.Share
  alias MavCodec.Msp.Trace
  alias Msp.Session

  @at "msp:auto, msp:DEVICE,BAUD or msp:tcp:HOST:PORT"
  @search ["bauds", "ports", "only"]

  @enforce_keys [:inner, :conn, :session, :ref]
  defstruct [:inner, :conn, :session, :ref, :timer, :share, :warning, late: [], traced: 0]

  @impl Transport
  def traits, do: %{kind: :msp, framing: :stream, client: nil}

  @impl Transport
  def forms do
    help = [
      {"msp:DEVICE,BAUD", "Betaflight or iNav at a serial port"},
      {"msp:tcp:HOST:PORT", "the same over TCP"}
    ]

    auto = [{"msp:auto", "find their serial port: ports where nothing comes are asked"}]
    own = ["sysid", "share", "share_origin"]

    [
      %Form{prefix: "msp:", expected: @at, example: "msp:/dev/ttyACM0,115200", help: help, options: own},
      %Form{prefix: "msp:auto", expected: @at, example: "msp:auto", help: auto, options: own ++ @search}
    ]
  end

  @impl Transport
  def parse("msp:auto", ""), do: {:ok, %{inner: Serial, detect: :port}}
  def parse("msp:auto", _more), do: {:error, "nothing but options follows msp:auto"}

  def parse(_prefix, rest) do
    {inner, form} = Transport.form(rest)

    with true <- inner in [Serial, TcpClient] || {:error, "MSP goes over serial ports and TCP"},
         {:ok, fields} <- inner.parse(form.prefix, String.replace_prefix(rest, form.prefix, "")) do
      if fields[:detect],
        do: {:error, "a port with MSP is searched for by msp:auto; else name the device and its baud rate"},
        else: {:ok, Map.put(fields, :inner, inner)}
    end
  end

  @impl Transport
  def option(prefix, name, value) when name in @search, do: Serial.option(prefix, name, value)

  def option(_prefix, "sysid", value) do
    case Integer.parse(value) do
      {id, ""} when id in 1..254 ->
        {:ok, :sysid, id}

      _other ->
        {:error,
         reason: "#{inspect(value)} is not a MAVLink id", expected: "sysid=1 to sysid=254", example: "sysid=7"}
    end
  end

  def option(_prefix, "share", value) do
    address = if value =~ ~r/\A\d+\z/, do: "127.0.0.1:" <> value, else: value

    with {:error, reason} <- Address.parse(address, true) do
      {:error, reason: reason, expected: "share=PORT or share=HOST:PORT", example: "share=5771"}
    else
      {:ok, host, port} -> {:ok, :share, {host, port}}
    end
  end

  def option(_prefix, "share_origin", value) do
    if value =~ ~r{\Ahttps?://[^/\s]+\z},
      do: {:ok, :share_origin, value},
      else:
        {:error,
         reason: "#{inspect(value)} is not the origin of a page",
         expected: "share_origin=https://HOST",
         example: "share_origin=https://app.betaflight.com"}
  end

  @impl Transport
  def place(spec), do: spec.inner.place(spec)
  @impl Transport
  def explain(reason, spec),
    do: if(function_exported?(spec.inner, :explain, 2), do: spec.inner.explain(reason, spec))

  @impl Transport
  def watch(spec), do: if(function_exported?(spec.inner, :watch, 1), do: spec.inner.watch(spec))

  @impl Transport
  def open(spec) do
    with {:ok, conn} <- spec.inner.open(spec) do
      session = Session.new(spec.sysid || 100 + :erlang.phash2(spec.id, 100))
      msp = %__MODULE__{inner: spec.inner, conn: conn, session: session, ref: make_ref()}

      # The vehicle is more than what else uses its line.
      case Share.open(spec) do
        {:ok, share} -> {:ok, %{msp | share: share}}
        {:error, text} -> {:ok, %{msp | warning: text}}
      end
    end
  end

  @impl Transport
  def give(msp, link), do: with(:ok <- Share.give(msp.share, link), do: msp.inner.give(msp.conn, link))

  @impl Transport
  def activate(msp) do
    with {:ok, conn, info} <- msp.inner.activate(msp.conn) do
      {share, _local} = Share.activate(msp.share)
      {events, msp} = step(%{msp | conn: conn, share: share}, :opened)
      {:ok, later(msp, events), if(msp.warning, do: Map.put(info, :warning, msp.warning), else: info)}
    end
  end

  @impl Transport
  def handle(%{late: [_ | _] = late} = msp, message) do
    with {events, msp} <- handle(%{msp | late: []}, message), do: {late ++ events, msp}
  end

  def handle(%{ref: ref} = msp, {__MODULE__, ref, :tick}), do: step(%{msp | timer: nil}, :tick)
  def handle(%{ref: ref} = msp, {__MODULE__, ref, :late}), do: {[], msp}

  def handle(msp, message) do
    case Share.handle(msp.share, message) do
      {events, share} ->
        steps(events, %{msp | share: share})

      :unknown ->
        with {events, conn} <- msp.inner.handle(msp.conn, message),
             do: Enum.reduce(events, {[], %{msp | conn: conn}}, &event/2)
    end
  end

  defp steps(events, msp) do
    Enum.reduce(events, {[], msp}, fn event, {events, msp} ->
      {more, msp} = step(msp, event)
      {events ++ more, msp}
    end)
  end

  defp event({:read, reads}, acc) do
    Enum.reduce(reads, acc, fn {:remote, bytes}, {events, msp} ->
      {more, msp} = step(msp, {:bytes, bytes})
      {events ++ more, msp}
    end)
  end

  defp event(event, {events, msp}), do: {events ++ [event], msp}

  @impl Transport
  def write(msp, _peer, bytes) do
    {events, msp} = step(msp, {:mavlink, IO.iodata_to_binary(bytes)})
    {:ok, later(msp, events)}
  end

  # The caller expects no events: they come with the next message, before its own.
  defp later(msp, []), do: msp

  defp later(%{late: late} = msp, events) do
    if late == [], do: send(self(), {__MODULE__, msp.ref, :late})
    %{msp | late: late ++ events}
  end

  @impl Transport
  def close(msp) do
    {_events, msp} = step(msp, :closing)
    Share.close(msp.share)
    msp.inner.close(msp.conn)
  end

  defp step(msp, event) do
    now = now()
    {session, actions} = Session.handle(msp.session, event, now)
    Enum.reduce(actions, trace({[], %{msp | session: session}}, {now, event}), &act/2)
  end

  # The frames are made only if the link is recorded.
  defp trace({events, %{traced: seq} = msp}, {_now, what} = entry) do
    make = fn ->
      Trace.frames(entry, system: msp.session.system, seq: seq, at: System.os_time(:microsecond))
    end

    {events ++ [{:traced, make}], %{msp | traced: seq + Trace.count(what)}}
  end

  defp act({:frames, frames}, {events, msp}), do: {events ++ [{:read, [{:remote, frames}]}], msp}
  defp act({:count, _name, _n} = count, {events, msp}), do: {events ++ [count], msp}
  defp act({:fail, text}, {events, msp}), do: {events ++ [{:closed, text}], msp}

  defp act({:client, id, :full}, {events, msp}), do: {events, %{msp | share: Share.drop(msp.share, id)}}

  defp act({:client, id, bytes}, {events, msp}) do
    {gone, share} = Share.write(msp.share, id, bytes)
    {more, msp} = steps(gone, %{msp | share: share})
    {events ++ more, msp}
  end

  defp act({:judge, id, message}, {events, msp}) do
    {more, msp} = step(msp, {:judged, id, Share.allowed?(msp.share, id, message)})
    {events ++ more, msp}
  end

  defp act({:write, bytes}, acc) do
    {events, msp} = trace(acc, {now(), {:written, bytes}})

    case msp.inner.write(msp.conn, :remote, bytes) do
      {:error, reason, conn} -> {events ++ [{:closed, reason}], %{msp | conn: conn}}
      # A request that did not fit is one without an answer.
      {_result, conn} -> {events, %{msp | conn: conn}}
    end
  end

  defp act({:wake, at}, {events, msp}) do
    _ = if msp.timer, do: Process.cancel_timer(msp.timer)

    {events,
     %{
       msp
       | timer: Process.send_after(self(), {__MODULE__, msp.ref, :tick}, max(div(at - now() + 999, 1000), 0))
     }}
  end

  defp now, do: :erlang.monotonic_time(:microsecond)
end
