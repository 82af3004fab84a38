defmodule Circuits.UART.Options do
  @moduledoc false
  # Checks the options of open/3 and configure/2 before anything is changed.

  @flags [
    rs485_enabled: 1,
    rs485_rts_on_send: 2,
    rs485_rts_after_send: 4,
    rs485_rx_during_tx: 8,
    rs485_terminate_bus: 16
  ]
  @delays [rs485_delay_rts_before_send: 32, rs485_delay_rts_after_send: 64]
  @flag_names Keyword.keys(@flags)
  @delay_names Keyword.keys(@delays)

  # The position in the list is the value on the wire (src/tty.h).
  @parities [:none, :even, :odd, :space, :mark, :ignore]
  @flow_controls [:none, :hardware, :software]

  defstruct active: true,
            speed: 9_600,
            data_bits: 8,
            stop_bits: 1,
            parity: :none,
            flow_control: :none,
            id: :name,
            rx_framing_timeout: 0,
            framing: {Circuits.UART.Framing.None, []},
            rs485: %{}

  @type t :: %__MODULE__{}

  @spec merge(t(), term()) :: {:ok, t()} | {:error, :einval}
  def merge(%__MODULE__{} = options, given) do
    if Keyword.keyword?(given) do
      Enum.reduce_while(given, {:ok, options}, fn option, {:ok, options} ->
        case put(options, option) do
          %__MODULE__{} = options -> {:cont, {:ok, options}}
          :error -> {:halt, {:error, :einval}}
        end
      end)
    else
      {:error, :einval}
    end
  end

  defp put(o, {:active, value}) when is_boolean(value), do: %{o | active: value}
  defp put(o, {:speed, value}) when is_integer(value) and value in 1..0xFFFFFFFF, do: %{o | speed: value}
  defp put(o, {:data_bits, value}) when value in 5..8, do: %{o | data_bits: value}
  defp put(o, {:stop_bits, value}) when value in 1..2, do: %{o | stop_bits: value}
  defp put(o, {:parity, value}) when value in @parities, do: %{o | parity: value}
  defp put(o, {:flow_control, value}) when value in @flow_controls, do: %{o | flow_control: value}
  defp put(o, {:id, value}) when value in [:name, :pid], do: %{o | id: value}
  defp put(o, {:rx_framing_timeout, value}) when is_integer(value), do: %{o | rx_framing_timeout: value}
  defp put(o, {:framing, {module, args}}) when is_atom(module), do: put_framing(o, module, args)
  defp put(o, {:framing, module}) when is_atom(module), do: put_framing(o, module, [])
  defp put(o, {name, value}) when name in @flag_names and is_boolean(value), do: put_rs485(o, name, value)

  defp put(o, {name, value}) when name in @delay_names and is_integer(value) and value in 0..0xFFFFFFFF,
    do: put_rs485(o, name, value)

  defp put(_options, _unknown), do: :error

  defp put_framing(options, module, args) do
    if Code.ensure_loaded?(module) and function_exported?(module, :remove_framing, 2),
      do: %{options | framing: {module, args}},
      else: :error
  end

  defp put_rs485(options, name, value), do: %{options | rs485: Map.put(options.rs485, name, value)}

  @doc "As `Circuits.UART.configuration/1` returns them."
  @spec to_list(t()) :: keyword()
  def to_list(%__MODULE__{framing: {module, _args}} = o) do
    [
      active: o.active,
      speed: o.speed,
      data_bits: o.data_bits,
      stop_bits: o.stop_bits,
      parity: o.parity,
      flow_control: o.flow_control,
      id: o.id,
      rx_framing_timeout: o.rx_framing_timeout,
      framing: module
    ] ++ Enum.sort(o.rs485)
  end

  @doc "The 19 bytes of settings that the port program expects (src/circuits_uart.c, settings_of)."
  @spec encode(t()) :: <<_::152>>
  def encode(%__MODULE__{rs485: rs485} = o) do
    given = bits(@flags ++ @delays, &Map.has_key?(rs485, &1))
    values = bits(@flags, &Map.get(rs485, &1, false))

    <<o.speed::32, o.data_bits, o.stop_bits, index(@parities, o.parity),
      index(@flow_controls, o.flow_control), if(o.active, do: 1, else: 0), given, values,
      Map.get(rs485, :rs485_delay_rts_before_send, 0)::32,
      Map.get(rs485, :rs485_delay_rts_after_send, 0)::32>>
  end

  defp bits(names, on?), do: Enum.sum_by(names, fn {name, bit} -> if on?.(name), do: bit, else: 0 end)
  defp index(list, value), do: Enum.find_index(list, &(&1 == value))
end
