defmodule Circuits.UART.WireTest do
  use ExUnit.Case, async: true

  alias Circuits.UART.{Options, Wire}

  test "decoding is total: any packet is an event of its type, or malformed" do
    type = :proper_types.oneof([?o, ?e, ?d, ?g, :proper_types.byte()])

    property =
      :proper.forall(:proper_types.tuple([type, :proper_types.binary()]), fn {type, rest} ->
        case {Wire.decode(<<type, rest::binary>>), type, rest} do
          {{:ok, id, result}, ?o, <<id::32, result::binary>>} -> true
          {{:error, id, _reason}, ?e, <<id::32, _name::binary>>} -> true
          {{:data, bytes}, ?d, bytes} -> bytes != ""
          {{:gone, told, _reason}, ?g, <<flag, _name::binary>>} -> told == (flag == 1)
          {:malformed, type, rest} when type in [?o, ?e] -> byte_size(rest) < 4
          {:malformed, ?d, rest} -> rest == ""
          {:malformed, ?g, rest} -> rest == "" or :binary.first(rest) > 1
          {:malformed, _type, _rest} -> true
          _wrong -> false
        end
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 2_000]) == true, inspect(:proper.counterexample())
    assert Wire.decode("") == :malformed
  end

  test "names of errors become atoms that exist, never new ones" do
    assert Wire.decode("e" <> <<7::32>> <> "enoent") == {:error, 7, :enoent}
    assert Wire.decode("g" <> <<1>> <> "eio") == {:gone, true, :eio}
    name = "surely_not_an_atom_#{System.unique_integer([:positive])}"
    assert Wire.decode("e" <> <<7::32>> <> name) == {:error, 7, :einval}
    assert_raise ArgumentError, fn -> String.to_existing_atom(name) end
  end

  test "every name that the port program can send is known here" do
    source = File.read!(Path.expand("../../../src/wire.c", __DIR__))
    names = Regex.scan(~r/\{E[A-Z]+, "([a-z]+)"\}/, source, capture: :all_but_first)
    assert length(names) > 20

    for [name] <- names do
      assert {:error, 1, reason} = Wire.decode("e" <> <<1::32>> <> name)
      assert Atom.to_string(reason) == name
    end
  end

  test "waits are bounded" do
    assert <<4, 1::32, 0x7FFFFFFF::32>> = Wire.read(1, 0xFFFFFFFFFF)
    assert <<6, 1::32, 0::32>> = Wire.drain(1, -5)
  end

  test "settings are the speed and the mode" do
    assert {:ok, options} = Options.merge(%Options{}, speed: 420_000, active: false)
    assert Options.encode(options) == <<420_000::32, 0>>
    assert Options.encode(%Options{}) == <<9_600::32, 1>>
  end
end
