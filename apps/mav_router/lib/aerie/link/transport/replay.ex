defmodule Aerie.Link.Transport.Replay do
  @moduledoc """
  A recorded tlog, gzipped or not, in place of a live link, in real time, scaled, or as fast as it is taken.

  The frames carry the times of their records. As fast as possible means: a batch is read when the vehicles' sessions have
  dealt with what they had before, so that neither the file's size nor a slow reader of it costs memory. At the end the
  link says how the recording ended, with what was damaged or cut off, and stays; with `loop=true` it begins anew.
  """
  @behaviour Aerie.Link.Transport

  alias Aerie.Link.Transport.Replay.Pacer
  alias MavCodec.Frame
  alias MavCodec.Tlog.Damage
  alias MavCodec.Tlog.Decoder

  @chunk 65_536
  # What is not gzipped is read as it is.
  @modes [:read, :raw, :binary, :compressed]
  @batch 256
  # Reads that may wait at a session before the next batch is read, and how soon that is looked at again.
  @backlog 16
  @look_ms 1
  # A gap in a recording is waited for in pieces, so that a clock that is set while it lasts does no harm.
  @most_ms 1_000

  @enforce_keys [:spec, :pacer, :ref]
  defstruct [
    :spec,
    :pacer,
    :ref,
    :device,
    :decoder,
    items: [],
    frames: 0,
    rounds: 0,
    damage: nil,
    busy: false
  ]

  @impl Aerie.Link.Transport
  def framing, do: :datagram

  # Opened once to see that it can be; the link's process opens it again, because a file belongs to its process.
  @impl Aerie.Link.Transport
  def open(spec) do
    with {:ok, device} <- :file.open(spec.file, @modes),
         {:ok, _or_eof} <- peek(device) do
      :ok = :file.close(device)
      {:ok, %__MODULE__{spec: spec, pacer: Pacer.new(spec.speed), ref: make_ref()}}
    end
  end

  defp peek(device) do
    case :file.read(device, 1) do
      {:ok, _byte} -> {:ok, device}
      :eof -> {:error, "the recording is empty"}
      {:error, reason} -> {:error, reason}
    end
  end

  @impl Aerie.Link.Transport
  def give(_conn, _link), do: :ok

  @impl Aerie.Link.Transport
  def activate(conn) do
    with {:ok, device} <- :file.open(conn.spec.file, @modes) do
      remind(conn, :read, 0)
      {:ok, begin(%{conn | device: device}), %{local: conn.spec.file}}
    end
  end

  defp begin(conn), do: %{conn | decoder: Decoder.new(), pacer: Pacer.new(conn.spec.speed)}

  @impl Aerie.Link.Transport
  def handle(%{ref: ref} = conn, {:replay, ref, :look}), do: {[{:records, []}], %{conn | busy: true}}

  def handle(%{ref: ref} = conn, {:replay, ref, :read}) do
    {records, conn, outcome} = take(conn, @batch, [], System.monotonic_time(:microsecond))
    records = {:records, Enum.reverse(records)}

    case outcome do
      :more ->
        {[records], %{conn | busy: true}}

      {:wait, ms} ->
        remind(conn, :read, min(ms, @most_ms))
        {[records], %{conn | busy: false}}

      :over ->
        {[records, {:ended, ending(conn)}], %{conn | busy: false}}

      {:error, reason} ->
        {[records, {:closed, reason}], %{conn | busy: false}}
    end
  end

  def handle(_conn, _message), do: :unknown

  defp take(conn, 0, records, _now), do: {records, conn, :more}

  defp take(%{items: [%Frame{} = frame | rest]} = conn, room, records, now) do
    case Pacer.judge(conn.pacer, frame.at, now) do
      {:due, pacer} ->
        conn = %{conn | pacer: pacer, items: rest, frames: conn.frames + 1}
        take(conn, room - 1, [{frame.at, frame.bytes} | records], now)

      {ms, pacer} ->
        {records, %{conn | pacer: pacer}, {:wait, ms}}
    end
  end

  defp take(%{items: [%Damage{} = damage | rest]} = conn, room, records, now) do
    take(%{conn | items: rest, damage: damage}, room, records, now)
  end

  defp take(%{decoder: nil} = conn, _room, records, _now) do
    # A file without a single frame would loop for ever.
    if conn.spec.loop and conn.frames > 0, do: rewind(conn, records), else: {records, conn, :over}
  end

  defp take(conn, room, records, now) do
    case :file.read(conn.device, @chunk) do
      {:ok, bytes} ->
        {items, decoder} = Decoder.push(conn.decoder, bytes)
        take(%{conn | items: items, decoder: decoder}, room, records, now)

      :eof ->
        take(%{conn | items: Decoder.finish(conn.decoder), decoder: nil}, room, records, now)

      {:error, reason} ->
        {records, conn, {:error, reason}}
    end
  end

  defp rewind(conn, records) do
    case :file.position(conn.device, 0) do
      {:ok, 0} -> {records, begin(%{conn | rounds: conn.rounds + 1}), :more}
      {:error, reason} -> {records, conn, {:error, reason}}
    end
  end

  defp ending(%{damage: nil} = conn), do: "end of #{conn.spec.file} after #{conn.frames} frames"
  defp ending(conn), do: "#{ending(%{conn | damage: nil})}; #{Damage.format(conn.damage)}"

  # Called after each batch: reads on, or looks a little later whether the sessions have caught up.
  @impl Aerie.Link.Transport
  def delivered(%{busy: false} = conn, _backlog), do: conn

  def delivered(conn, backlog) do
    if backlog > @backlog, do: remind(conn, :look, @look_ms), else: remind(conn, :read, 0)
    %{conn | busy: false}
  end

  defp remind(conn, what, 0), do: send(self(), {:replay, conn.ref, what})
  defp remind(conn, what, ms), do: Process.send_after(self(), {:replay, conn.ref, what}, ms)

  @impl Aerie.Link.Transport
  def write(conn, _peer, _bytes), do: {:error, :erofs, conn}

  @impl Aerie.Link.Transport
  def close(%{device: nil}), do: :ok

  def close(conn) do
    _ = :file.close(conn.device)
    :ok
  end
end
