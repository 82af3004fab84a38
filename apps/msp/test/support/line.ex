defmodule Msp.Test.Line do
  @moduledoc """
  A session at a line, in simulated time: what it writes goes to a function that answers, after some milliseconds, and what it tells
  in MAVLink is collected. With `record: true` it has the frames of its recording, too, the last one first.
  """

  alias MavCodec.Msp.Trace
  alias Msp.Session

  defstruct [
    :session,
    :answer,
    now: 1_000_000_000_000,
    wake: nil,
    coming: [],
    told: [],
    written: [],
    failed: nil,
    counted: %{},
    delay: 10_000,
    clients: [],
    full: [],
    judged: [],
    judge: nil,
    record: false,
    recorded: [],
    seq: 0
  ]

  @doc "A line whose other end is `answer`: `(bytes, time in us since the beginning) -> bytes | nil`. It is opened."
  def open(answer, options \\ []) do
    line =
      struct!(
        %__MODULE__{session: Session.new(options[:system] || 42), answer: answer},
        Keyword.take(options, [:delay, :judge, :record, :now])
      )

    handle(line, :opened)
  end

  @doc "Lets `us` pass."
  def run(%{failed: nil, counted: %{}} = line, us), do: until(line, line.now + us)
  def run(line, _us), do: line

  @doc "An event now."
  def handle(line, event) do
    {session, actions} = Session.handle(line.session, event, line.now)
    Enum.reduce(actions, trace(%{line | session: session}, event), &act/2)
  end

  defp trace(%{record: false} = line, _what), do: line

  defp trace(%{seq: seq} = line, what) do
    frames = Trace.frames({line.now, what}, system: line.session.system, seq: seq, at: line.now)
    %{line | recorded: Enum.reverse(frames, line.recorded), seq: seq + length(frames)}
  end

  defp record(%{record: false} = line, _frames), do: line
  defp record(line, frames), do: %{line | recorded: Enum.reverse(frames, line.recorded)}

  @doc "The messages told so far, decoded, each with its time in us since the beginning; those of one kind."
  def told(line, module), do: for({at, %^module{} = message} <- told(line), do: {at, message})

  def told(line) do
    for {at, frames} <- Enum.reverse(line.told), frame <- frames do
      {:ok, message} = MavCodec.decode(frame)
      {at - 1_000_000_000_000, message}
    end
  end

  defp until(%{failed: nil, counted: %{}} = line, target) do
    case Enum.min(Enum.map(line.coming, &elem(&1, 0)) ++ List.wrap(line.wake), fn -> nil end) do
      at when is_integer(at) and at <= target ->
        line |> Map.put(:now, max(at, line.now)) |> due() |> until(target)

      _later ->
        %{line | now: target}
    end
  end

  defp until(line, _target), do: line

  defp due(%{coming: coming, now: now} = line) do
    case Enum.split_with(coming, fn {at, _bytes} -> at <= now end) do
      {[], _later} ->
        handle(%{line | wake: nil}, :tick)

      {arrived, later} ->
        Enum.reduce(Enum.sort(arrived), %{line | coming: later}, fn {_at, bytes}, line ->
          handle(line, {:bytes, bytes})
        end)
    end
  end

  defp act({:write, bytes}, line) do
    line = trace(%{line | written: [{line.now, bytes} | line.written]}, {:written, bytes})

    case line.answer.(bytes, line.now - 1_000_000_000_000) do
      nil -> line
      answer -> %{line | coming: [{line.now + delay(line, bytes, answer), answer} | line.coming]}
    end
  end

  defp act({:frames, frames}, line),
    do: record(%{line | told: [{line.now, frames} | line.told]}, frames)

  defp act({:count, name, n}, line), do: %{line | counted: Map.update(line.counted, name, n, &(&1 + n))}
  defp act({:client, id, :full}, line), do: %{line | full: [id | line.full]}
  defp act({:client, id, bytes}, line), do: %{line | clients: [{line.now, id, bytes} | line.clients]}

  defp act({:judge, id, message}, line) do
    allowed? = if line.judge, do: line.judge.(message), else: true
    handle(%{line | judged: [message | line.judged]}, {:judged, id, allowed?})
  end

  defp act({:wake, at}, line), do: %{line | wake: at}
  defp act({:fail, text}, line), do: %{line | failed: text}

  # As long for all, or by the bytes and the time.
  defp delay(%{delay: delay} = line, bytes, answer) when is_function(delay),
    do: delay.(bytes, answer, line.now)

  defp delay(%{delay: delay}, _bytes, _answer), do: delay
end
