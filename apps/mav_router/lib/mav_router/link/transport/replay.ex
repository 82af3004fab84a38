defmodule MavRouter.Link.Transport.Replay do
  @moduledoc """
  A recorded tlog, gzipped or not, in real time, scaled, or as fast as possible.

  Frames have the times of their records. As fast as possible means that a batch is read when the vehicles' sessions have
  handled the one before, so that neither a large file nor a slow session costs memory. At its end the link stays, and says
  how the recording ended and what was damaged or cut off; with `loop=true` it starts over. Anything but a tlog is refused.
  """
  @behaviour MavRouter.Link.Transport

  alias MavRouter.Link.Transport.Form
  alias MavRouter.Link.Transport.Query
  alias MavRouter.Link.Transport.Replay.Pacer
  alias MavCodec.Frame
  alias MavCodec.Msp.Trace
  alias MavCodec.Tlog.Damage
  alias MavCodec.Tlog.Decoder

  @chunk 65_536
  # Files that are not gzipped are read unchanged.
  @modes [:read, :raw, :binary, :compressed]
  @batch 256
  # Messages that may wait at a session before the next batch is read, and how soon they are counted again.
  @backlog 16
  @look_ms 1
  # A long gap in a recording is waited for in pieces, so that setting the clock meanwhile does no harm.
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
    damage: nil,
    jump: nil,
    busy: false
  ]

  @impl MavRouter.Link.Transport
  def traits, do: %{kind: :replay, framing: :datagram, recorded: true, client: nil}

  @impl MavRouter.Link.Transport
  def forms do
    [
      %Form{
        prefix: "replay:",
        expected: "replay:FILE",
        example: "replay:flight.tlog?speed=max",
        help: [{"replay:FILE", "play a recorded flight (a .tlog file)"}],
        options: ["speed", "loop"]
      }
    ]
  end

  @impl MavRouter.Link.Transport
  def parse(_prefix, ""), do: {:error, "the file is missing"}
  def parse(_prefix, file), do: {:ok, %{file: file}}

  @impl MavRouter.Link.Transport
  def option(_prefix, "loop", value), do: Query.boolean(:loop, value)
  def option(_prefix, "speed", "max"), do: {:ok, :speed, :max}

  def option(_prefix, "speed", value) do
    case Float.parse(value) do
      {number, ""} when number >= 0.01 and number <= 10_000 ->
        {:ok, :speed, number}

      _other ->
        {:error,
         reason: "#{inspect(value)} is not a valid speed", expected: "speed=N (0.01 to 10000) or speed=max"}
    end
  end

  @impl MavRouter.Link.Transport
  def place(spec), do: Path.basename(spec.file)

  @impl MavRouter.Link.Transport
  def explain(:enoent, spec), do: "there is no file #{spec.file}"
  def explain(:eisdir, spec), do: "#{spec.file} is a folder"
  def explain(_reason, _spec), do: nil

  # Opened to see whether it can be; the link's process opens it again, because a file belongs to a process.
  @impl MavRouter.Link.Transport
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

  @impl MavRouter.Link.Transport
  def give(_conn, _link), do: :ok

  @impl MavRouter.Link.Transport
  def activate(conn) do
    with {:ok, device} <- :file.open(conn.spec.file, @modes) do
      remind(conn, :read, 0)
      {:ok, begin(%{conn | device: device}), %{local: conn.spec.file}}
    end
  end

  defp begin(conn), do: %{conn | decoder: Decoder.new(), pacer: Pacer.new(conn.spec.speed)}

  @impl MavRouter.Link.Transport
  def handle(%{ref: ref} = conn, {:replay, ref, :look}), do: {[{:records, []}], %{conn | busy: true}}

  def handle(%{ref: ref} = conn, {:replay, ref, :read}) do
    {records, conn, outcome} = take(conn, @batch, [], System.monotonic_time(:microsecond))
    events = jumped(conn.jump) ++ [{:records, Enum.reverse(records)}]
    conn = %{conn | jump: nil}

    case outcome do
      :more ->
        {events, %{conn | busy: true}}

      {:wait, ms} ->
        remind(conn, :read, min(ms, @most_ms))
        {events, %{conn | busy: false}}

      :over ->
        {events ++ [{:ended, ending(conn)}], %{conn | busy: false}}

      {:error, reason} ->
        {events ++ [{:closed, reason}], %{conn | busy: false}}
    end
  end

  def handle(_conn, _message), do: :unknown

  # A step back is usual: two recordings in one file.
  defp jumped(us) when us == nil or us < 0, do: []

  defp jumped(us) do
    text =
      "the recording's time goes on by #{div(us, 1_000_000)} s at once (a gap, or its clock was set): not waited for"

    [{:warning, text}]
  end

  defp take(conn, 0, records, _now), do: {records, conn, :more}

  defp take(%{items: [%Frame{} = frame | rest]} = conn, room, records, now) do
    case Pacer.schedule(conn.pacer, frame.at, now) do
      {:due, pacer} ->
        conn = %{conn | pacer: pacer, items: rest, frames: conn.frames + 1}
        take(conn, room - 1, [{frame.at, frame.bytes} | records], now)

      # A batch ends here, so that the sessions find the jump where they look for it: at the first frame of a batch.
      {{:jump, us}, pacer} when records == [] ->
        take(%{conn | pacer: pacer, jump: us}, room, [], now)

      {{:jump, _us}, _pacer} ->
        {records, conn, :more}

      {ms, pacer} ->
        {records, %{conn | pacer: pacer}, {:wait, ms}}
    end
  end

  defp take(%{items: [%Damage{kind: :raw} = damage | _none]} = conn, _room, records, _now),
    do: {records, %{conn | items: [], decoder: nil, damage: damage}, :over}

  defp take(%{items: [%Damage{} = damage | rest]} = conn, room, records, now) do
    take(%{conn | items: rest, damage: damage}, room, records, now)
  end

  defp take(%{decoder: nil} = conn, _room, records, _now) do
    # A file without any frame would loop for ever.
    if conn.spec.loop and conn.frames > 0, do: rewind(conn, records), else: {records, conn, :over}
  end

  defp take(conn, room, records, now) do
    case :file.read(conn.device, @chunk) do
      {:ok, bytes} ->
        {items, decoder} = Decoder.push(conn.decoder, bytes)
        take(%{conn | items: said(items), decoder: decoder}, room, records, now)

      :eof ->
        take(%{conn | items: said(Decoder.finish(conn.decoder)), decoder: nil}, room, records, now)

      {:error, reason} ->
        {records, conn, {:error, reason}}
    end
  end

  # What went over a line with MSP was said by no vehicle.
  defp said(items), do: Enum.reject(items, &(is_struct(&1, Frame) and Trace.frame?(&1)))

  defp rewind(conn, records) do
    case :file.position(conn.device, 0) do
      {:ok, 0} -> {records, begin(conn), :more}
      {:error, reason} -> {records, conn, {:error, reason}}
    end
  end

  defp ending(%{damage: nil} = conn), do: "end of #{conn.spec.file} after #{conn.frames} frames"
  defp ending(conn), do: "#{ending(%{conn | damage: nil})}; #{Damage.format(conn.damage)}"

  # Called after each batch: reads on, or checks a little later whether the sessions have caught up.
  @impl MavRouter.Link.Transport
  def delivered(%{busy: false} = conn, _backlog), do: conn

  def delivered(conn, backlog) do
    if backlog > @backlog, do: remind(conn, :look, @look_ms), else: remind(conn, :read, 0)
    %{conn | busy: false}
  end

  defp remind(conn, what, 0), do: send(self(), {:replay, conn.ref, what})
  defp remind(conn, what, ms), do: Process.send_after(self(), {:replay, conn.ref, what}, ms)

  @impl MavRouter.Link.Transport
  def write(conn, _peer, _bytes), do: {:error, :erofs, conn}

  @impl MavRouter.Link.Transport
  def close(%{device: nil}), do: :ok

  def close(conn) do
    _ = :file.close(conn.device)
    :ok
  end
end
