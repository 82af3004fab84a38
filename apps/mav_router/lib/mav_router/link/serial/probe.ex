defmodule MavRouter.Link.Serial.Probe do
  @quiet_ms 11_000

  @moduledoc """
  Listens to one serial port at one baud rate after the other: a pure value, used by `MavRouter.Link.Serial.Detector`.

  - It listens at each rate for a little more than the period of heartbeats, or until 600 bytes contain no frame: at the right
    rate a whole frame would be among them.
  - The first good frame settles the rate; the probe then waits for a heartbeat.
  - Readable text also settles it: boot messages come before MAVLink on the same line.
  - A port that is in use is tried again for two seconds.
  - Another protocol with good checksums ends the probe: the port is not ours.
  - A silent port gets five seconds in all, one that is not silent gets all rates.

  It never writes to the port, unless it searches for a flight controller with MSP, which only answers (`msp:auto`): then
  it asks one question at each rate, once nothing came at any of them for #{div(@quiet_ms, 1000)} s. Some radios bring a
  heartbeat every ten seconds. The question is which firmware it has (FC_VARIANT), which all of them have answered since
  before MSP had versions.
  """

  alias MavCodec.{Msp, Parser, Sniff}
  alias MavRouter.Link.Serial.Finding

  # Heartbeats come once a second.
  @window_ms 1_200
  @heartbeat_ms 5_000
  # Flight controllers answer within 20 ms, through a radio within half a second.
  @answer_ms 600
  @busy_ms 2_000
  @read_ms 250
  @enough_bytes 600
  @max_buffer 4_096
  @sure 0.95
  @text 0.6
  @fc_variant 2
  @vehicles %{"BTFL" => "Betaflight", "INAV" => "iNav"}

  @enforce_keys [:port, :bauds, :started]
  defstruct [
    :port,
    :bauds,
    :started,
    :baud,
    :deadline,
    :opened,
    :parser,
    phase: :opening,
    buffer: "",
    count: 0,
    # At this rate: whether a good frame was received; whether the rate is kept because of text.
    framed: false,
    staying: false,
    # Whether it searches for MSP, and has asked at this rate.
    ask: false,
    asked: false,
    # Since when nothing came.
    quiet: nil,
    tried: [],
    outcome: nil
  ]

  @type event ::
          :opened
          | {:open_failed, term}
          | {:read, binary}
          | {:read_failed, term}
          | :set
          | {:set_failed, term}
          | {:failed, term}
          | :tick
  @type action ::
          {:open, pos_integer} | {:set, pos_integer} | {:read, non_neg_integer} | {:write, binary} | :close

  @typedoc """
  `outcome`: nil while listening, `{:hit, finding, bytes}` with the bytes of this rate so far, `{:over, finding}`.
  """
  @type t :: %__MODULE__{}

  @doc "Starts with a port; `bauds` are the candidates in order; `ask`: whether it searches for MSP."
  @spec new(map, [pos_integer, ...], integer, boolean) :: {t, [action]}
  def new(port, [baud | bauds], now, ask \\ false) do
    {%__MODULE__{port: port, bauds: bauds, started: now, baud: baud, ask: ask}, [{:open, baud}]}
  end

  @doc "Whether it has listened for a whole window, in which a vehicle would have been heard."
  @spec warmed_up?(t, integer) :: boolean
  def warmed_up?(%{opened: nil}, _now), do: false
  def warmed_up?(probe, now), do: now - probe.opened >= @window_ms and not probe.framed

  @doc "Handles one event. After the outcome nothing more happens."
  @spec handle(t, event, integer) :: {t, [action]}
  def handle(%{outcome: outcome} = probe, _event, _now) when outcome != nil, do: {probe, []}

  def handle(%{phase: :opening} = probe, :opened, now) do
    listen(%{probe | opened: now, quiet: now}, now)
  end

  def handle(%{phase: :busy} = probe, :tick, _now), do: {%{probe | phase: :opening}, [{:open, probe.baud}]}

  # The port does not support the rate.
  def handle(%{phase: :opening, bauds: bauds} = probe, {:open_failed, :einval}, _now) do
    case bauds do
      [baud | bauds] -> {%{probe | baud: baud, bauds: bauds}, [{:open, baud}]}
      [] -> fail(probe, "it supports none of the baud rates")
    end
  end

  def handle(%{phase: :opening} = probe, {:open_failed, reason}, now) do
    # Most likely this link itself still has it, and is about to close it.
    if busy?(reason) and now - probe.started < @busy_ms,
      do: {%{probe | phase: :busy}, []},
      else: fail(probe, reason)
  end

  def handle(%{phase: :setting} = probe, :set, now), do: listen(probe, now)

  def handle(%{phase: :setting} = probe, {:set_failed, :einval}, now), do: next(probe, now)
  def handle(%{phase: :setting} = probe, {:set_failed, reason}, _now), do: fail(probe, reason)
  def handle(%{phase: :listening} = probe, {:read_failed, reason}, _now), do: fail(probe, reason)
  def handle(probe, {:failed, reason}, _now), do: fail(probe, reason)
  def handle(%{phase: :listening} = probe, {:read, bytes}, now), do: probe |> take(bytes, now) |> decide(now)
  def handle(probe, _other, _now), do: {probe, []}

  @doc "Ends the probe: what is known so far is the outcome."
  @spec stop(t, integer) :: {t, [action]}
  def stop(%{outcome: outcome} = probe, _now) when outcome != nil, do: {probe, []}
  def stop(%{opened: nil} = probe, _now), do: fail(probe, "opening it takes too long")
  def stop(probe, now), do: over(note(probe), now)

  defp busy?({:in_use, _who}), do: true
  defp busy?(reason), do: reason in [:eagain, :ebusy]

  defp listen(probe, now) do
    probe = %{probe | phase: :listening, parser: Parser.new(), deadline: now + @window_ms}
    probe = %{probe | buffer: "", count: 0, framed: false, staying: false, asked: false}
    {probe, [read(probe, now)]}
  end

  defp read(probe, now), do: {:read, max(0, min(@read_ms, probe.deadline - now))}

  defp take(probe, "", _now), do: probe

  defp take(%{ask: true} = probe, bytes, now) do
    probe = %{probe | quiet: now, count: probe.count + byte_size(bytes), buffer: keep(probe.buffer, bytes)}

    case answer(probe.buffer, probe.port.path, probe.baud) do
      nil -> probe
      %{condition: :vehicle} = finding -> %{probe | outcome: {:hit, finding, ""}}
      finding -> %{probe | outcome: {:over, finding}}
    end
  end

  defp take(probe, bytes, now) do
    {frames, parser} = Parser.push(probe.parser, bytes)

    probe = %{
      probe
      | parser: parser,
        count: probe.count + byte_size(bytes),
        buffer: keep(probe.buffer, bytes)
    }

    good? = Enum.any?(frames, & &1.crc_extra)

    cond do
      Enum.any?(frames, &Sniff.Mavlink.heartbeat?/1) -> hit(probe)
      good? and not probe.framed -> %{probe | framed: true, deadline: now + @heartbeat_ms}
      true -> probe
    end
  end

  defp keep(buffer, bytes) do
    all = buffer <> bytes
    if byte_size(all) <= @max_buffer, do: all, else: binary_part(all, byte_size(all), -@max_buffer)
  end

  defp hit(probe) do
    # In a flood the heartbeat may already have left the buffer.
    sniffed =
      case Sniff.classify(probe.buffer) do
        %{heartbeat: true} = sniffed -> sniffed
        _cut -> %{protocol: :mavlink2, confidence: 1.0, evidence: "a heartbeat", heartbeat: true}
      end

    finding = Finding.from_listening(probe.port.path, probe.baud, sniffed)
    %{probe | outcome: {:hit, finding, probe.buffer}}
  end

  defp decide(%{outcome: {:hit, _finding, _bytes}} = probe, _now), do: {probe, []}
  defp decide(%{outcome: {:over, _finding}} = probe, _now), do: {%{probe | phase: :closed}, [:close]}

  defp decide(%{ask: true, asked: false, count: 0, deadline: deadline} = probe, now) when now >= deadline do
    if now - probe.quiet < @quiet_ms do
      probe = %{probe | deadline: probe.quiet + @quiet_ms}
      {probe, [read(probe, now)]}
    else
      probe = %{probe | asked: true, deadline: now + @answer_ms}
      {probe, [{:write, question()}, read(probe, now)]}
    end
  end

  defp decide(probe, now) do
    cond do
      now >= probe.deadline and (probe.framed or probe.staying) -> over(note(probe), now)
      now >= probe.deadline -> evaluate(probe, now)
      probe.framed or probe.staying -> {probe, [read(probe, now)]}
      probe.count >= @enough_bytes -> evaluate(probe, now)
      true -> {probe, [read(probe, now)]}
    end
  end

  # No frame at this rate.
  defp evaluate(probe, now) do
    case Sniff.classify(probe.buffer) do
      %{protocol: :console, confidence: confidence} when confidence >= @text ->
        probe = %{probe | staying: true, deadline: now + @heartbeat_ms}
        {probe, [read(probe, now)]}

      %{protocol: protocol, confidence: confidence}
      when protocol not in [:noise, :silence, :console] and confidence >= @sure ->
        over(note(probe), now)

      _noise_or_silence ->
        next(note(probe), now)
    end
  end

  defp note(%{phase: :listening} = probe) do
    %{probe | tried: [{probe.baud, probe.count, Sniff.classify(probe.buffer)} | probe.tried]}
  end

  defp note(probe), do: probe

  defp next(probe, now) do
    silent? = Enum.all?(probe.tried, fn {_baud, count, _sniffed} -> count == 0 end)

    case probe.bauds do
      # Those that may be asked were.
      [] when probe.ask -> over(probe, now)
      _any when silent? and not probe.ask and now - probe.started >= @heartbeat_ms -> over(probe, now)
      [] when silent? -> start_over(probe)
      [] -> over(probe, now)
      [baud | bauds] -> {%{probe | phase: :setting, baud: baud, bauds: bauds}, [{:set, baud}]}
    end
  end

  # All rates were tried and time is left: starts over.
  defp start_over(probe) do
    case probe.tried |> Enum.map(&elem(&1, 0)) |> Enum.reverse() do
      [] ->
        fail(probe, "it supports none of the baud rates")

      [baud | bauds] ->
        {%{probe | phase: :setting, tried: [], baud: baud, bauds: bauds}, [{:set, baud}]}
    end
  end

  defp over(probe, now) do
    heard = Enum.reject(probe.tried, fn {_baud, count, _sniffed} -> count == 0 end)

    finding =
      case Enum.max_by(heard, &weight/1, fn -> nil end) do
        nil ->
          Finding.silent(probe.port.path, Float.round((now - probe.started) / 1000, 1))

        {baud, _count, sniffed} ->
          Finding.from_listening(probe.port.path, baud, others(sniffed, length(heard) - 1))
      end

    {%{probe | outcome: {:over, finding}, phase: :closed}, [:close]}
  end

  defp others(%{protocol: :noise, evidence: evidence} = sniffed, n) when n > 0,
    do: %{sniffed | evidence: "#{evidence}, and no better at #{Sniff.count(n, "other rate")}"}

  defp others(sniffed, _n), do: sniffed

  defp weight({_baud, count, %{protocol: :noise}}), do: {0, count}
  defp weight({_baud, _count, %{confidence: confidence}}), do: {1, confidence}

  defp fail(probe, reason) do
    {%{probe | outcome: {:over, Finding.failed(probe.port.path, reason)}, phase: :closed}, [:close]}
  end

  # The same bytes in every firmware.
  defp question, do: %Msp.Frame{id: @fc_variant} |> Msp.Frame.encode() |> IO.iodata_to_binary()

  # What the bytes that came say of the port; nil if they do not answer.
  defp answer(bytes, path, baud) do
    {frames, parser} = Msp.Parser.push(Msp.Parser.new(), bytes)

    cond do
      reply = Enum.find(frames, &match?(%{id: @fc_variant, direction: :reply}, &1)) ->
        variant(reply.payload, path, baud)

      # A command line sends back what can be printed of it.
      Enum.any?(frames, &match?(%{id: @fc_variant, direction: :request}, &1)) or
          Msp.Parser.pending(parser) == "$M<" ->
        finding(
          path,
          baud,
          :other_protocol,
          "our own question comes back",
          "its command line is open, or the line is looped back"
        )

      Sniff.classify(bytes).heartbeat ->
        finding(
          path,
          baud,
          :other_protocol,
          "it speaks MAVLink",
          "its connection string is serial:auto or DEVICE,BAUD"
        )

      true ->
        nil
    end
  end

  defp variant(<<variant::binary-size(4), _::binary>>, path, baud) when is_map_key(@vehicles, variant),
    do: finding(path, baud, :vehicle, "answers as #{@vehicles[variant]}", nil)

  defp variant(other, path, baud) do
    name = for <<byte <- binary_slice(other, 0, 8)>>, byte in 33..126, into: "", do: <<byte>>
    finding(path, baud, :other_protocol, ~s(answers as "#{name}"), "neither Betaflight nor iNav")
  end

  defp finding(path, baud, condition, evidence, advice),
    do: %Finding{
      path: path,
      condition: condition,
      protocol: :msp1,
      baud: baud,
      evidence: evidence,
      advice: advice
    }
end
