defmodule Circuits.UART.Framing.None do
  @moduledoc "No framing: bytes in the pieces in which they come."

  @behaviour Circuits.UART.Framing

  @impl Circuits.UART.Framing
  def init(_args), do: {:ok, nil}

  @impl Circuits.UART.Framing
  def add_framing(data, state), do: {:ok, data, state}

  @impl Circuits.UART.Framing
  def remove_framing(data, state), do: {:ok, [data], state}

  @impl Circuits.UART.Framing
  def frame_timeout(state), do: {:ok, [], state}

  @impl Circuits.UART.Framing
  def flush(_direction, state), do: state
end
