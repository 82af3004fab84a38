defmodule Aerie.Base.AddressTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Address

  test "which addresses are this machine's own" do
    for ip <- [{127, 0, 0, 1}, {127, 9, 9, 9}, {0, 0, 0, 0, 0, 0, 0, 1}, {0, 0, 0, 0, 0, 0xFFFF, 0x7F00, 1}],
        do: assert(Address.loopback?(ip))

    for ip <- [
          {10, 0, 0, 1},
          {0, 0, 0, 0, 0, 0xFFFF, 0x0A00, 1},
          {0xFE80, 0, 0, 0, 0, 0, 0, 1},
          {0, 0, 0, 0, 0, 0, 0, 0}
        ],
        do: refute(Address.loopback?(ip))
  end
end
