defmodule Msp.Rerun do
  @moduledoc """
  A recorded line with MSP, handled again: a session gets what the recorded one got (`MavCodec.Msp.Trace`), and has to write and to say the same, byte
  for byte.

      rerun = Enum.reduce(frames, Msp.Rerun.new(7), fn frame, rerun -> elem(Msp.Rerun.push(rerun, frame), 1) end)
      rerun.difference

  `frames` are all of a link's recording, in their order. It begins where the line was opened; what a recording has from before that (of a link
  that is recorded while it is armed) is not compared.
  """

  alias MavCodec.Frame
  alias MavCodec.Msp.Trace
  alias Msp.Session

  @enforce_keys [:system]
  defstruct [
    :system,
    :session,
    :trace,
    :difference,
    told: "",
    written: "",
    counts: %{entries: 0, frames: 0, writes: 0}
  ]

  @typedoc """
  - `system`: the vehicle's MAVLink id
  - `session`: nil as long as the line was not opened
  - `told`, `written`: what the session said and wrote, and the recording has yet to say
  - `counts`: entries of the line; MAVLink frames and writes that were the same
  - `difference`: the first one: when (unix microseconds), what, and its bytes in the recording and here; nil for none
  """
  @type t :: %__MODULE__{
          system: byte,
          session: Session.t() | nil,
          trace: Trace.t(),
          difference: nil | %{at: integer, what: :frame | :write, recorded: binary, here: binary},
          told: binary,
          written: binary,
          counts: %{entries: non_neg_integer, frames: non_neg_integer, writes: non_neg_integer}
        }

  @doc "The line of the vehicle with this MAVLink id, before its recording's first frame."
  @spec new(1..254) :: t
  def new(system), do: %__MODULE__{system: system}

  @doc "The next frame of the recording, and the entry of the line that it completes."
  @spec push(t, Frame.t()) :: {Trace.entry() | nil, t}
  def push(%{system: system} = rerun, %Frame{system: system} = frame) do
    if Trace.frame?(frame) do
      {entry, trace} = Trace.push(rerun.trace, frame)
      {entry, entry(%{rerun | trace: trace}, entry, frame.at)}
    else
      {nil, said(rerun, frame)}
    end
  end

  # Another sender's, on its way to the vehicle.
  def push(rerun, _frame), do: {nil, rerun}

  defp entry(rerun, nil, _at), do: rerun

  defp entry(rerun, {_now, {:written, bytes}}, at),
    do: rerun |> count(:entries) |> compare(:write, :written, :writes, bytes, at)

  # What was on its way when the line was closed was not recorded.
  defp entry(rerun, {_now, :opened} = entry, _at),
    do: step(%{rerun | session: Session.new(rerun.system), told: "", written: ""}, entry)

  defp entry(%{session: nil} = rerun, _before, _at), do: count(rerun, :entries)
  defp entry(rerun, entry, _at), do: step(rerun, entry)

  defp step(rerun, {now, event}) do
    {session, actions} = Session.handle(rerun.session, event, now)
    told = for {:frames, frames} <- actions, %{bytes: bytes} <- frames, into: rerun.told, do: bytes
    written = for {:write, bytes} <- actions, into: rerun.written, do: bytes
    count(%{rerun | session: session, told: told, written: written}, :entries)
  end

  defp said(rerun, %Frame{bytes: bytes, at: at}), do: compare(rerun, :frame, :told, :frames, bytes, at)

  defp compare(%{session: nil} = rerun, _what, _key, _counter, _bytes, _at), do: rerun
  defp compare(%{difference: %{}} = rerun, _what, _key, _counter, _bytes, _at), do: rerun

  defp compare(rerun, what, key, counter, bytes, at) do
    size = byte_size(bytes)

    case Map.fetch!(rerun, key) do
      <<^bytes::binary-size(^size), rest::binary>> ->
        rerun |> Map.put(key, rest) |> count(counter)

      other ->
        here = binary_slice(other, 0, size)
        %{rerun | difference: %{at: at, what: what, recorded: bytes, here: here}}
    end
  end

  defp count(rerun, counter), do: %{rerun | counts: Map.update!(rerun.counts, counter, &(&1 + 1))}
end
