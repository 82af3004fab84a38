defmodule MavCodec.Ftp.PackedParamsTest do
  use ExUnit.Case, async: true

  alias MavCodec.Ftp.PackedParams

  @params [
    {"ACRO_BAL_PITCH", 9, 1.0, 1.5},
    {"ACRO_BAL_ROLL", 9, -1.0, nil},
    {"ACRO_OPTIONS", 2, -128, 0},
    {"A", 4, 32_767, nil},
    {"AHRS_ORIENTATION", 6, -2_147_483_648, 7},
    {"AHRS_ORIENTATIOM", 2, 127, 127}
  ]

  defp decode(bytes), do: PackedParams.decode(bytes, 5_000)

  test "names share what they begin with with the name before; a default is there where it differs" do
    assert PackedParams.encode([{"AB", 4, 1, 0}, {"AC", 4, 2, nil}], false, 239) ==
             <<0x671B::little-16, 2::little-16, 2::little-16, 2, 0x10, "AB", 1, 0, 2, 1, "C", 2, 0>>

    assert PackedParams.encode([{"AB", 4, 1, 0}, {"AC", 4, 2, 2}], true, 239) ==
             <<0x671C::little-16, 2::little-16, 2::little-16, 0x12, 0x10, "AB", 1, 0, 0, 0, 2, 1, "C", 2, 0>>

    assert PackedParams.path(false) == "@PARAM/param.pck"
    assert PackedParams.path(true) == "@PARAM/param.pck?withdefaults=1"
  end

  test "what was encoded is decoded, without defaults and with them" do
    assert decode(PackedParams.encode(@params, false, 239)) ==
             {:ok, for({name, type, value, _default} <- @params, do: {name, type, value, nil})}

    # The file says of a parameter without a default that it has its default.
    assert decode(PackedParams.encode(@params, true, 239)) ==
             {:ok, for({name, type, value, default} <- @params, do: {name, type, value, default || value})}

    assert decode(PackedParams.encode([], false, 239)) == {:ok, []}
  end

  test "no value lies in two reads, whatever their size" do
    for piece <- [32, 80, 110, 239] do
      bytes = PackedParams.encode(@params, true, piece)
      assert {:ok, read} = decode(bytes)
      assert length(read) == length(@params)

      # Each piece alone ends with a whole record: what is before it is a file of fewer parameters.
      for cut <- piece..byte_size(bytes)//piece do
        <<magic::binary-size(2), _counts::32, records::binary>> = binary_part(bytes, 0, cut)
        counts = for n <- 0..6, do: <<n::little-16, n::little-16>>
        assert Enum.any?(counts, &match?({:ok, _params}, decode(magic <> &1 <> records)))
      end
    end
  end

  test "any list comes through" do
    name = :proper_types.list(:proper_types.range(33, 126))
    value = :proper_types.range(-128, 127)
    param = {name, :proper_types.elements([2, 4, 6, 9]), value, value}

    property =
      :proper.forall({:proper_types.list(param), :proper_types.range(26, 239)}, fn {list, piece} ->
        params =
          for {name, type, value, default} <- list, name != [], uniq: true do
            number = if type == 9, do: &(&1 / 4), else: & &1
            {name |> Enum.take(16) |> List.to_string(), type, number.(value), number.(default)}
          end
          |> Enum.uniq_by(&elem(&1, 0))

        decode(PackedParams.encode(params, true, piece)) == {:ok, params}
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 300]) == true, inspect(:proper.counterexample())
  end

  test "a part of a file, or one that goes on, is an error that says so" do
    for defaults? <- [false, true] do
      file = PackedParams.encode(@params, defaults?, 239)
      for n <- 0..(byte_size(file) - 1), do: assert({:error, _why} = decode(binary_part(file, 0, n)))
      assert {:error, "the file goes on after 6 parameters"} = decode(file <> <<1, 0, ?X, 1>>)
      assert {:ok, _params} = decode(file <> <<0, 0, 0>>)
    end

    assert {:error, "the file ends after 4 of 6 parameters"} =
             decode(binary_part(PackedParams.encode(@params, false, 239), 0, 60))
  end

  test "what cannot be: other bytes, other counts, too many, a name twice, names and types that are impossible" do
    header = fn count, total -> <<0x671B::little-16, count::little-16, total::little-16>> end

    for {bytes, reason} <- [
          {"", "not a parameter file: it begins with other bytes"},
          {<<0x671D::little-16, 0::32>>, "not a parameter file: it begins with other bytes"},
          {header.(1, 2), "the file has 1 of 2 parameters"},
          {header.(9000, 9000), "9000 parameters, more than 5000"},
          {header.(2, 2) <> <<1, 0, ?X, 1, 1, 0, ?X, 1>>, "a parameter comes twice"},
          {header.(1, 1) <> <<1, 0, ?\s, 1>>, "an impossible name after the header"},
          {header.(2, 2) <> <<1, 0, ?X, 1, 1, 0, 200, 1>>, "an impossible name after X"},
          {header.(1, 1) <> <<5, 0, ?X, 1>>, "unknown type or name after the header"},
          {header.(1, 1) <> <<1, 1, ?X, 1>>, "unknown type or name after the header"}
        ],
        do: assert(decode(bytes) == {:error, reason})
  end

  test "a value that is NaN or infinite is nil, and the file whole" do
    for bits <- [0x7FC00000, 0x7F800000, 0xFF800000] do
      bytes =
        <<0x671B::little-16, 2::little-16, 2::little-16, 4, 0, "X", bits::little-32, 4, 0, "Y",
          1.0::float-little-32>>

      assert decode(bytes) == {:ok, [{"X", 9, nil, nil}, {"Y", 9, 1.0, nil}]}
    end
  end

  test "whatever comes, nothing raises" do
    garbage =
      :proper.forall(:proper_types.binary(), fn bytes -> match?({:error, _why}, decode(bytes)) end)

    file = PackedParams.encode(@params, true, 64)

    damage =
      :proper.forall({:proper_types.range(0, byte_size(file) - 1), :proper_types.byte()}, fn {at, byte} ->
        <<before::binary-size(^at), _old, rest::binary>> = file

        case decode(<<before::binary, byte, rest::binary>>) do
          {:ok, params} -> length(params) == 6 and Enum.all?(params, &PackedParams.name?(elem(&1, 0)))
          {:error, reason} -> is_binary(reason)
        end
      end)

    for property <- [garbage, damage],
        do:
          assert(
            :proper.quickcheck(property, [:quiet, numtests: 1000]) == true,
            inspect(:proper.counterexample())
          )
  end

  test "names have 1 to 16 printable characters without spaces (P1)" do
    for good <- ["A", "ABCDEFGHIJKLMNOP", "a-b.c"], do: assert(PackedParams.name?(good))
    for bad <- ["", "ABCDEFGHIJKLMNOPQ", "A B", <<255>>, nil], do: refute(PackedParams.name?(bad))
  end
end
