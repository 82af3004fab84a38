defmodule Circuits.UART.Options do
  @moduledoc false
  # Checks the options of open/3 and configure/2 before anything is changed.

  defstruct active: true, speed: 9_600, id: :name

  @type t :: %__MODULE__{active: boolean(), speed: 1..0xFFFFFFFF, id: :name | :pid}

  @spec merge(t(), term()) :: {:ok, t()} | {:error, :einval}
  def merge(%__MODULE__{} = options, given) do
    if Keyword.keyword?(given) and Enum.all?(given, &valid?/1),
      do: {:ok, struct!(options, given)},
      else: {:error, :einval}
  end

  defp valid?({:active, value}), do: is_boolean(value)
  defp valid?({:speed, value}), do: is_integer(value) and value in 1..0xFFFFFFFF
  defp valid?({:id, value}), do: value in [:name, :pid]
  defp valid?(_unknown), do: false

  @doc "As `Circuits.UART.configuration/1` returns them."
  @spec to_list(t()) :: keyword()
  def to_list(%__MODULE__{} = options), do: [active: options.active, speed: options.speed, id: options.id]

  @doc "The settings that the port program expects (src/wire.h)."
  @spec encode(t()) :: <<_::40>>
  def encode(%__MODULE__{} = options), do: <<options.speed::32, if(options.active, do: 1, else: 0)>>
end
