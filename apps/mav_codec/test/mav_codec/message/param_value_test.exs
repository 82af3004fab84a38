defmodule MavCodec.Message.ParamValueTest do
  use ExUnit.Case, async: true

  alias MavCodec.Message.ParamValue

  test "what is encoded is decoded, in both ways (P2)" do
    property =
      :proper.forall(typed(), fn {type, value, encoding} ->
        case ParamValue.encode(value, type, encoding) do
          {:ok, wire} -> match?({:ok, ^value, _exact}, ParamValue.decode(wire, type, encoding))
          {:error, _reason} -> encoding == :c_cast and type in [5, 6] and abs(value) > 0x1000000
        end
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 2000]) == true, inspect(:proper.counterexample())
  end

  defp typed do
    integers =
      for type <- 1..6 do
        {low, high} = ParamValue.range(type)

        :proper_types.tuple([
          type,
          :proper_types.oneof([low, high, :proper_types.integer(low, high)]),
          :proper_types.oneof([:c_cast, :bytewise])
        ])
      end

    :proper_types.oneof(integers)
  end

  test "PX4's integers are bytes, ArduPilot's are numbers" do
    assert ParamValue.encode(5, 6, :c_cast) == {:ok, 5.0}
    assert ParamValue.decode(7.006492321624085e-45, 6, :bytewise) == {:ok, 5, true}
    assert ParamValue.decode(:nan, 6, :bytewise) == {:ok, 0x7FC00000, true}
    assert ParamValue.encode(-1, 6, :bytewise) == {:ok, {:nan, 0xFFFFFFFF}}
    assert ParamValue.decode(:nan, 9, :c_cast) == :error
  end

  test "what a PARAM_SET asks for is what was encoded, and never another number" do
    property =
      :proper.forall(typed(), fn {type, value, encoding} ->
        with {:ok, wire} <- ParamValue.encode(value, type, encoding) do
          own = ParamValue.asked(wire, type, encoding)
          # An integer of 32 bits may look like a number; none that a vehicle has is so large.
          own == {:ok, if(encoding == :c_cast, do: value * 1.0, else: value)} or
            (type == 6 and encoding == :bytewise and abs(value) > 0x2000_0000 and match?({:error, _}, own))
        else
          {:error, _too_large} -> true
        end
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 2000]) == true, inspect(:proper.counterexample())

    for {value, type} <- [{1, 1}, {-128, 2}, {1001, 3}, {-7, 4}, {47, 6}, {-16_777_216, 6}],
        do: assert({:error, "it has an integer's type" <> _} = ParamValue.asked(value * 1.0, type, :bytewise))

    assert ParamValue.asked(47.0, 9, :bytewise) == {:ok, 47.0}
    assert ParamValue.asked(47.0, 1, :c_cast) == {:ok, 47.0}
    assert {:error, _nan} = ParamValue.asked(:nan, 9, :bytewise)
    # The bits of an unsigned integer may be those of any float.
    assert ParamValue.asked(47.0, 5, :bytewise) == {:ok, 0x423C0000}
  end

  test "an integer above 2^24 loses bits as a float: it is not sent changed, and is marked when it is read" do
    assert {:error, "16777217 would become 16777216" <> _why} = ParamValue.encode(16_777_217, 6, :c_cast)
    assert {:ok, _wire} = ParamValue.encode(16_777_217, 6, :bytewise)
    assert {:ok, _even} = ParamValue.encode(16_777_218, 6, :c_cast)
    assert ParamValue.decode(16_777_216.0, 6, :c_cast) == {:ok, 16_777_216, false}
    assert ParamValue.decode(16_777_215.0, 6, :c_cast) == {:ok, 16_777_215, true}
  end

  test "what does not fit is not encoded" do
    for {value, type} <- [
          {128, 2},
          {-1, 1},
          {1.5, 4},
          {1.0e39, 9},
          {1, 8},
          {4_294_967_296, 5},
          {10 ** 400, 9}
        ],
        do: assert({:error, _reason} = ParamValue.encode(value, type, :c_cast))
  end

  test "values are the same if a vehicle could not tell them apart" do
    assert ParamValue.same?(0.1, ParamValue.float32(0.1))
    refute ParamValue.same?(0.1, 0.1000001)
    assert ParamValue.same?(5, 5.0)
    refute ParamValue.same?(16_777_216, 16_777_217)
    refute ParamValue.same?(1.0e39, 1.0e38)
  end
end
