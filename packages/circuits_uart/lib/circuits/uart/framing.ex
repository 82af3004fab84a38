defmodule Circuits.UART.Framing do
  @moduledoc """
  Splits the bytes of a serial line into messages.

  A framing is a value and these functions on it; the process that serves the port keeps the value. Received bytes come
  in pieces cut anywhere: however they are cut, the same messages must come out.

  A message can be any term. One that is wrong (a checksum, say) is best given as an `{:error, reason, ...}` tuple, and
  one that did not come whole as `{:partial, data}`. What is kept of an unfinished message must be bounded.
  """

  @typedoc "The framing's own value."
  @type state :: term()

  @doc "A fresh state from the `args` in `framing: {module, args}` (`[]` if only the module was given)."
  @callback init(args :: term()) :: {:ok, state()} | {:error, reason :: term()}

  @doc "The bytes to send for message `data`."
  @callback add_framing(data :: term(), state()) ::
              {:ok, binary(), state()} | {:error, reason :: term(), state()}

  @doc "The messages that `new_data` completes, in order; `:in_frame` if a part of another message is left."
  @callback remove_framing(new_data :: binary(), state()) ::
              {:in_frame, [term()], state()} | {:ok, [term()], state()}

  @doc "What to return of an unfinished message whose rest did not come within `:rx_framing_timeout`."
  @callback frame_timeout(state()) :: {:ok, [term()], state()}

  @doc "Forgets unfinished messages of that direction."
  @callback flush(direction :: :receive | :transmit | :both, state()) :: state()
end
