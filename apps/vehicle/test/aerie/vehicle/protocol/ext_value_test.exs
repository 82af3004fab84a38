defmodule Aerie.Vehicle.Protocol.ExtValueTest do
  @moduledoc "P8: values of extended parameters."
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Protocol.ExtValue

  test "numbers of each type go there and back, at the ends of their ranges" do
    ends = [{1, 0, 255}, {2, -128, 127}, {3, 0, 65_535}, {4, -32_768, 32_767}, {5, 0, 4_294_967_295}]

    more = [
      {6, -2_147_483_648, 2_147_483_647},
      {7, 0, 18_446_744_073_709_551_615},
      {8, -9_223_372_036_854_775_808, 9_223_372_036_854_775_807}
    ]

    for {type, least, most} <- ends ++ more, value <- [least, most] do
      assert {:ok, bytes} = ExtValue.encode(value, type)
      assert ExtValue.decode(pad(bytes), type) == value
      assert {:error, "expected " <> _} = ExtValue.encode(most + 1, type)
      assert {:error, _} = ExtValue.encode(least - 1, type)
      assert {:error, _} = ExtValue.encode(0.5, type)
    end

    # 5.0 is what a browser makes of 5.
    assert ExtValue.encode(5.0, 1) == ExtValue.encode(5, 1)
    assert ExtValue.encode("5", 1) == {:error, "expected a number"}
  end

  defp pad(bytes), do: bytes <> :binary.copy(<<0>>, 128 - byte_size(bytes))

  test "floats; what is not finite is not known" do
    for type <- [9, 10] do
      assert {:ok, bytes} = ExtValue.encode(1.5, type)
      assert ExtValue.decode(pad(bytes), type) == 1.5
      assert ExtValue.decode(:binary.copy(<<0xFF>>, 128), type) == nil
    end

    assert {:error, "expected a number that fits a float" <> _} = ExtValue.encode(1.0e300, 9)
  end

  test "text, and bytes that are not text, can be sent back as they came" do
    assert ExtValue.decode(pad("photo"), 11) == "photo"

    assert ExtValue.decode(pad("photo" <> <<0, "graph", 255>>), 11) == "photo"

    for bytes <- ["photo", <<0, 1, 2>>, <<1, 2, 255>>, "base64:x", ""] do
      value = ExtValue.decode(pad(bytes), 11)
      assert String.printable?(value)
      assert ExtValue.encode(value, 11) == {:ok, bytes}
    end

    assert {:error, _} = ExtValue.encode(String.duplicate("x", 129), 11)
    assert {:error, "expected base64" <> _} = ExtValue.encode("base64:%%%", 11)
    assert {:error, _} = ExtValue.encode(5, 11)
  end
end
