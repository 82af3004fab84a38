defmodule MavCodec.Enums do
  @moduledoc """
  The enums and bitmasks of all sources, one module each, such as `MavCodec.Enums.MavState`:

    * `value(name)` - the number of a name: `value(:MAV_STATE_ACTIVE)` is 4
    * `name(number)` - the name of a number, `nil` if it has none: `name(4)` is `:MAV_STATE_ACTIVE`
    * `label(number)` - the same without the prefix: `"ACTIVE"`
    * `all()` - all of them: `[{name, value}]`
    * `flags(number)` - bitmasks only: the flags that are set, and unknown bits

  Messages keep the numbers, so unknown values pass through unchanged.
  """

  import Bitwise

  @doc false
  @spec flags(non_neg_integer(), [{atom(), non_neg_integer()}]) :: {[atom()], non_neg_integer()}
  def flags(value, all) do
    Enum.reduce(Enum.reverse(all), {[], value}, fn {name, bits}, {names, unknown} ->
      if bits != 0 and (value &&& bits) == bits,
        do: {[name | names], unknown &&& bnot(bits)},
        else: {names, unknown}
    end)
  end
end
