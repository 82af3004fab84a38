defmodule Circuits.UART.Test.PickyFraming do
  @moduledoc "A framing that refuses."

  @behaviour Circuits.UART.Framing

  @impl Circuits.UART.Framing
  def init([]), do: {:ok, nil}
  def init(_args), do: {:error, :bad_args}

  @impl Circuits.UART.Framing
  def add_framing("no", state), do: {:error, :not_this, state}
  def add_framing(data, state), do: {:ok, data, state}

  @impl Circuits.UART.Framing
  def remove_framing(data, state), do: {:ok, [data], state}

  @impl Circuits.UART.Framing
  def frame_timeout(state), do: {:ok, [], state}

  @impl Circuits.UART.Framing
  def flush(_direction, state), do: state
end
