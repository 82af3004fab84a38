defmodule Aerie.Fleet.Shadow.Store.LeaseSealTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Secret
  alias Aerie.Fleet.Shadow.Store.LeaseSeal
  alias Aerie.Fleet.Shadow.Keys

  defp hub, do: %Keys{common: Secret.new("the key of the whole fleet")}

  defp aboard(vehicle),
    do: %Keys{
      common: Secret.new("a random one of its own"),
      own: %{vehicle => Secret.new(Keys.derive("the key of the whole fleet", "test", vehicle))}
    }

  defp seal(keys, subject, value, number) do
    [{"Aerie-Seal", seal}] = LeaseSeal.headers(keys, "test", subject, value, number)
    seal
  end

  test "nothing of what is sealed can be exchanged" do
    seal = seal(hub(), {:vehicle, "A"}, "gw", 5)
    assert LeaseSeal.read(hub(), "test", {:vehicle, "A"}, "gw", seal) == {:ok, 5}
    assert LeaseSeal.read(hub(), "test", {:vehicle, "A"}, "gw", nil) == :unsealed

    for {environment, subject, value} <- [
          {"prod", {:vehicle, "A"}, "gw"},
          {"test", {:vehicle, "B"}, "gw"},
          {"test", {:gateway, "A"}, "gw"},
          {"test", {:vehicle, "A"}, "evil"}
        ],
        do: assert(LeaseSeal.read(hub(), environment, subject, value, seal) == :forged)

    "5 " <> mac = seal
    other = %Keys{common: Secret.new("another key altogether")}

    for forged <- ["6 " <> mac, mac, "", "5", "5 ", " ", "-5 " <> mac, "5 " <> String.upcase(mac), "x y"],
        do: assert(LeaseSeal.read(hub(), "test", {:vehicle, "A"}, "gw", forged) == :forged)

    assert LeaseSeal.read(other, "test", {:vehicle, "A"}, "gw", seal) == :forged
  end

  test "aboard the key of its own vehicle speaks for that one alone" do
    name = LeaseSeal.name("0123", aboard("A"))
    assert LeaseSeal.name("0123", hub()) == "0123"

    for subject <- [{:gateway, name}, {:vehicle, "A"}],
        do:
          assert(LeaseSeal.read(hub(), "test", subject, "v", seal(aboard("A"), subject, "v", 1)) == {:ok, 1})

    for subject <- [{:gateway, "0123"}, {:gateway, "0123-B"}, {:vehicle, "B"}],
        do: assert(LeaseSeal.read(hub(), "test", subject, "v", seal(aboard("A"), subject, "v", 1)) == :forged)
  end
end
