defmodule Msp.Mission.MwpTest do
  use ExUnit.Case, async: true

  alias Msp.Mission.Mwp
  alias Protocols.Mission.File.Waypoints
  alias Protocols.Mission.{Item, Plan}

  # As mwp writes one, and one in the capitals of older programs.
  @mwp """
  <?xml version="1.0" encoding="utf-8"?>
  <mission>
    <!--mw planner 0.01-->
    <version value="2.3-pre8"></version>
    <mwp zoom="15" cx="8.5456" cy="47.3977" home-x="8.5456" home-y="47.3977" generator="mwp"></mwp>
    <missionitem no="1" action="WAYPOINT" lat="47.3977418" lon="8.5455939" alt="35" parameter1="0" parameter2="0" parameter3="0" flag="0"></missionitem>
    <missionitem no="2" action="WAYPOINT" lat="47.3987418" lon="8.5455939" alt="523.5" parameter1="750" parameter2="0" parameter3="3" flag="0"/>
    <missionitem no="3" action="POSHOLD_TIME" lat="47.3987418" lon="8.5465939" alt="40" parameter1="20" parameter2="0" parameter3="0" flag="0"/>
    <missionitem no="4" action="JUMP" lat="0.0" lon="0.0" alt="0" parameter1="2" parameter2="3" parameter3="0" flag="0"/>
    <missionitem no="5" action="RTH" lat="47.1" lon="8.1" alt="25" parameter1="1" parameter2="0" parameter3="0" flag="165"/>
  </mission>
  """

  test "a file of mwp as a plan that counts from 1, and written again" do
    assert {:ok, %Plan{home: nil, items: items} = plan} = Mwp.read(@mwp)
    assert Enum.map(items, & &1.command) == [16, 178, 16, 31_010, 178, 19, 177, 20]
    assert [%{x: 473_977_418, y: 85_455_939, z: 35.0, frame: 3}, %{params: {1.0, 7.5, _, _}}, msl | _] = items
    assert %{frame: 0, z: 523.5} = msl
    # To the speed of the second waypoint, the second item.
    assert %{params: {2.0, 3.0, _, _}} = Enum.at(items, 6)
    assert %{params: {+0.0, _, _, _}} = List.last(items)
    assert {:ok, text} = Mwp.write(plan)
    assert Mwp.read(text) == {:ok, plan}
    assert text =~ ~s(no="2" action="WAYPOINT" lat="47.3987418" lon="8.5455939" alt="523.5" parameter1="750")

    assert text =~
             ~s(no="5" action="RTH" lat="0" lon="0" alt="0" parameter1="1" parameter2="0" parameter3="0" flag="165")

    assert {:ok, ^plan} = @mwp |> String.replace("missionitem", "MISSIONITEM") |> Mwp.read()
  end

  test "what is wrong, with its line and item" do
    wrong = fn from, to -> @mwp |> String.replace(from, to) |> Mwp.read() end

    assert {:error, "line 6, item 1: expected an action (HOLD_TIME, JUMP" <> _} =
             wrong.(~s(no="1" action="WAYPOINT"), ~s(action="FLIP"))

    assert {:error, "line 6, item 1: action is missing"} = wrong.(~s(no="1" action="WAYPOINT"), "")

    assert {:error, "line 8, item 3: expected a number for lon, got \"east\""} =
             wrong.(~s(lon="8.5465939"), ~s(lon="east"))

    assert {:error, "line 6, item 1: a mission ends here" <> _} =
             wrong.(
               ~s(alt="35" parameter1="0" parameter2="0" parameter3="0" flag="0"),
               ~s(alt="35" flag="165")
             )

    assert {:error, "waypoint 4 jumps to waypoint 9, which is not there" <> _} =
             wrong.(~s(parameter1="2"), ~s(parameter1="9"))

    assert {:error, "waypoint 4 jumps to a waypoint beside it" <> _} =
             wrong.(~s(parameter1="2"), ~s(parameter1="3"))

    for {name, rest} <- [
          {"lat", ~s( lon="8.5455939" alt="35")},
          {"lon", ~s( alt="35")},
          {"alt", ~s( parameter1="0")}
        ] do
      given = Regex.run(~r/ #{name}="[^"]*"#{rest}/, @mwp) |> hd()
      assert wrong.(given, rest) == {:error, "line 6, item 1: #{name} is missing"}
    end

    assert {:error, "line 6, item 1: flag goes" <> _} =
             wrong.(~s(parameter3="0" flag="0"></mis), ~s(flag="999"></mis))

    assert {:error, "the file has no missionitem"} = Mwp.read("<mission></mission>")
    assert {:error, "line " <> _} = Mwp.read("<mission><missionitem></mission>")
    assert {:error, "line 1: the file is not XML" <> _} = Mwp.read("QGC WPL 110")
    assert {:error, "the file is larger" <> _} = Mwp.read(String.duplicate(" ", 1_100_000))
    many = String.duplicate(~s(<missionitem action="RTH"/>), 121)
    assert {:error, "the file has 121 items" <> _} = Mwp.read("<mission>#{many}</mission>")
  end

  test "entities, which could make a small file a large one, are refused; nothing in a file becomes an atom" do
    bomb = ~s(<!DOCTYPE m [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;">]><mission>&b;</mission>)
    assert {:error, "line 1: the file is not XML: Entities not allowed" <> _} = Mwp.read(bomb)
    assert {:error, _} = Mwp.read(~s(<!DOCTYPE m SYSTEM "file:///etc/passwd"><mission>&b;</mission>))
    fields = for n <- 1..500, do: ~s( strange#{n}x="#{n}")
    assert {:ok, _plan} = Mwp.read("<mission><missionitem action='RTH'#{fields}/></mission>")
    for n <- 1..500, do: assert_raise(ArgumentError, fn -> String.to_existing_atom("strange#{n}x") end)
  end

  test "any bytes give a plan or an error" do
    mutated =
      :proper.forall({:proper_types.range(0, byte_size(@mwp) - 1), :proper_types.binary()}, fn {at, bytes} ->
        <<before::binary-size(^at), _byte, behind::binary>> = @mwp

        case Mwp.read(before <> bytes <> behind) do
          {:ok, %Plan{}} -> true
          {:error, why} -> is_binary(why) and String.valid?(why)
        end
      end)

    assert :proper.quickcheck(mutated, [:quiet, numtests: 500]) == true, inspect(:proper.counterexample())
  end

  test "a plan that iNav cannot fly is not written" do
    {:ok, plan} = Waypoints.read("QGC WPL 120\n0\t1\t3\t22\t0\t0\t0\t0\t47.1\t8.1\t20\t1\n")
    assert {:error, "item 1: iNav takes off by hand" <> _} = Mwp.write(plan)
    assert {:error, "item 1: " <> _} = Mwp.write(%Plan{items: [%Item{command: 16, frame: 10, x: 1, y: 1}]})
  end
end
