defmodule Circuits.UART.Framing.Line do
  @moduledoc ~S"""
  Each message is a line. The separator is appended to each sent message, and removed from each received one.

      Circuits.UART.open(uart, "ttyUSB0", framing: {Circuits.UART.Framing.Line, separator: "\r\n"})

    * `:separator` (binary of one byte or more, `"\n"`)
    * `:max_length` (bytes without the separator, `4096`) - of a longer line each `max_length` bytes come as
      `{:partial, data}` and the end of it as a line

  With `:rx_framing_timeout`, an unfinished line comes as `{:partial, data}`, too.
  """

  @behaviour Circuits.UART.Framing

  defmodule State do
    @moduledoc false
    # processed: the line so far; in_process: bytes that may or may not begin a separator.
    defstruct max_length: 4_096, separator: "\n", processed: "", in_process: ""
  end

  @impl Circuits.UART.Framing
  def init(args) do
    with true <- Keyword.keyword?(args),
         {:ok, args} <- Keyword.validate(args, max_length: 4_096, separator: "\n"),
         %State{max_length: max_length, separator: separator} = state <- struct(State, args),
         true <- is_integer(max_length) and max_length > 0 and is_binary(separator) and separator != "" do
      {:ok, state}
    else
      _wrong -> {:error, :einval}
    end
  end

  @impl Circuits.UART.Framing
  def add_framing(data, state), do: {:ok, data <> state.separator, state}

  @impl Circuits.UART.Framing
  def remove_framing(data, state) do
    # No separator begins in `processed`, so it is not searched again.
    searched = byte_size(state.processed)
    {rest, messages} = split(state.processed <> state.in_process <> data, searched, state, [])
    kept = byte_size(rest) - min(byte_size(rest), byte_size(state.separator) - 1)
    <<processed::binary-size(^kept), in_process::binary>> = rest
    status = if rest == "", do: :ok, else: :in_frame
    {status, Enum.reverse(messages), %{state | processed: processed, in_process: in_process}}
  end

  defp split(bytes, searched, %State{separator: separator, max_length: max_length} = state, messages) do
    case :binary.match(bytes, separator, scope: {searched, byte_size(bytes) - searched}) do
      {at, size} when at <= max_length ->
        <<line::binary-size(^at), _separator::binary-size(^size), rest::binary>> = bytes
        split(rest, 0, state, [line | messages])

      {_at, _size} ->
        split_long(bytes, state, messages)

      :nomatch when byte_size(bytes) - max_length >= byte_size(separator) ->
        split_long(bytes, state, messages)

      :nomatch ->
        {bytes, messages}
    end
  end

  defp split_long(bytes, %State{max_length: max_length} = state, messages) do
    <<part::binary-size(^max_length), rest::binary>> = bytes
    split(rest, 0, state, [{:partial, part} | messages])
  end

  @impl Circuits.UART.Framing
  def frame_timeout(state) do
    partial = if buffer_empty?(state), do: [], else: [{:partial, state.processed <> state.in_process}]
    {:ok, partial, empty(state)}
  end

  @impl Circuits.UART.Framing
  def flush(:transmit, state), do: state
  def flush(_receive_or_both, state), do: empty(state)

  @doc "Whether no part of a line waits for its rest."
  @spec buffer_empty?(%State{}) :: boolean()
  def buffer_empty?(%State{processed: processed, in_process: in_process}),
    do: processed == "" and in_process == ""

  defp empty(state), do: %{state | processed: "", in_process: ""}
end
