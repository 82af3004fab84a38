defmodule Aerie.Console.Pages.Params.ListingTest do
  use ExUnit.Case, async: true

  alias Aerie.Control.Params
  alias Aerie.Control.Params.{Param, Table}
  alias Aerie.Console.Pages.Params.Listing

  # MAV_PARAM_TYPE: 4 int16, 9 real32
  @params [
    %Param{name: "RTL_ALT", value: 2000, type: 4, default: 1500},
    %Param{name: "ANGLE_MAX", value: 3000, type: 4, default: 3000},
    %Param{name: "ATC_RAT_P", value: 0.13500000536441803, type: 9, default: nil, exact: false}
  ]
  @table Table.new(@params)
  @all %{search: "", only: "all"}

  defp names({rows, _count}), do: Enum.map(rows, & &1.name)

  test "rows by name, searched, changed only" do
    assert {[_, _, _], 3} = Listing.rows(@table, [], %{}, @all)
    assert ["ANGLE_MAX", "ATC_RAT_P", "RTL_ALT"] == names(Listing.rows(@table, [], %{}, @all))
    assert ["ATC_RAT_P"] == names(Listing.rows(@table, [], %{}, %{@all | search: "rat atc"}))
    assert ["RTL_ALT"] == names(Listing.rows(@table, [], %{}, %{@all | only: "changed"}))

    assert {[
              %{value: "3000", default: "3000", changed: false, type: "int16", exact: true},
              %{value: "0.135", default: nil, changed: nil, exact: false} | _
            ], 3} =
             Listing.rows(@table, [], %{}, @all)
  end

  test "cautions: what protects, and a vehicle that may fly; what is not known counts as that" do
    says = fn names, mode -> Listing.cautions(names, mode && %{groups: %{mode: %{data: mode}}}) end
    still = %{armed: false, in_air: false}
    assert says.(["ATC_RAT_P"], still) == []

    # ArduPilot, PX4, Betaflight and iNav.
    for name <- ~w(FENCE_ALT_MAX FS_THR_ENABLE GF_MAX_VER_DIST COM_ARM_WO_GPS FAILSAFE_DELAY SMALL_ANGLE) do
      assert says.([name], still) == ["What protects the vehicle changes: #{name}."]
    end

    assert says.(["RTL_ALT"], %{armed: true, in_air: false}) == ["The vehicle is armed, or may be."]
    assert says.(["RTL_ALT"], %{armed: false, in_air: true}) == ["The vehicle is in the air, or may be."]
    assert [_armed, _air] = says.(["RTL_ALT"], %{armed: nil, in_air: nil})
    assert [_armed, _air] = says.(["RTL_ALT"], nil)
  end

  test "a file: what differs, and what the vehicle does not have" do
    {:ok, entries} =
      Params.parse("RTL_ALT,1500\nATC_RAT_P,0.135000\nANGLE_MAX,3000\nNO_SUCH,1\n")

    assert {[%{name: "RTL_ALT", value: 1500, type: 4}], ["NO_SUCH"]} = Params.differing(entries, @table)

    assert {[%{name: "RTL_ALT", file: "1500"}], 1} =
             Listing.rows(@table, entries, %{}, %{@all | only: "differs"})
  end

  test "no more rows than a page can show" do
    many = Table.new(for n <- 1..300, do: %Param{name: "P#{n}", value: n, type: 6})
    assert {rows, 300} = Listing.rows(many, [], %{}, @all)
    assert length(rows) == Listing.max()
  end

  test "numbers as they are typed and shown" do
    assert {:ok, 5} == Listing.number(" 5 ")
    assert {:ok, -0.5} == Listing.number("-0.5")
    for text <- ["", "5 m", "0,5", "five"], do: assert(:error == Listing.number(text))
    assert "16777217" == Listing.text(16_777_217)

    for float <- [0.1, 1.0e-7, 123.456, -2.5],
        do:
          assert(
            float |> MavCodec.Message.ParamValue.float32() |> Listing.text() |> Listing.number() ==
              {:ok, float}
          )
  end
end
