Code.require_file("../../bin/lib/checks/layers.exs", __DIR__)

defmodule Aerie.Gate.LayersTest do
  @moduledoc "What `bin/layers --check` refuses, each by something made up that is added to the apps as they are."

  use ExUnit.Case, async: true

  alias Layers.{Firmwares, Graph, Limits, Readme, Source}

  setup_all do
    apps = Layers.read()
    %{apps: apps, control: Enum.find(apps, &(&1.name == :control))}
  end

  describe "cycles" do
    test "of two files are found in each app", %{apps: apps} do
      for %{edges: edges} = app <- apps do
        # Other than a file and one in the folder of its name, which may use each other.
        {from, to} =
          Enum.find(edges, arrow(app), fn {from, to} ->
            Path.dirname(to) != from and Path.dirname(from) != to
          end)

        assert ["apps/" <> text] = Layers.problems(%{app | edges: [{from, to}, {to, from} | edges]})
        assert text =~ ~r/^#{app.name}: a cycle of files/
        assert text =~ "\n  lib/#{from}.ex -> lib/#{to}.ex" and text =~ "\n  lib/#{to}.ex -> lib/#{from}.ex"
      end
    end

    test "of two parts of its main folder are found in each app", %{apps: apps} do
      for app <- apps do
        # An app that is too small for an arrow gets one.
        edges = if Graph.arrows(app.edges, app.main) == [], do: [arrow(app)], else: app.edges
        {from, to} = hd(Graph.arrows(edges, app.main))
        # These files form no cycle.
        back = {path(app, [to, "made_up"]), path(app, [from, "made_up"])}

        assert [problem] = new_folder_cycles(app, [back | edges])
        assert problem =~ ~r/^apps\/#{app.name}: .*: a cycle of folders, by \d+ uses, 0 at most\n/
        assert problem =~ "\n  lib/#{elem(back, 0)}.ex -> lib/#{elem(back, 1)}.ex"
      end
    end

    test "of a part that is one file, and of folders further down, are found in each app", %{apps: apps} do
      for app <- apps do
        part = [
          {path(app, ["one"]), path(app, ["other", "a"])},
          {path(app, ["other", "b"]), path(app, ["one"])}
        ]

        down =
          for {a, b} <- [{"one", "other"}, {"other", "one"}],
              do: {path(app, ["deep", a, "x#{b}"]), path(app, ["deep", b, "y#{a}"])}

        assert [problem] = new_folder_cycles(app, part ++ app.edges)
        assert problem =~ ": #{path(app, ["one"])}, #{path(app, ["other"])}: a cycle of folders, by 2 uses"
        assert [problem] = new_folder_cycles(app, down ++ app.edges)

        assert problem =~
                 ": #{path(app, ["deep/one"])}, #{path(app, ["deep/other"])}: a cycle of folders, by 2 uses"
      end
    end
  end

  describe "apps" do
    test "use none above them, and those that their mix.exs names", %{control: app} do
      assert Layers.problems(%{app | uses: app.uses ++ [:fleet]}) == [
               "apps/control uses fleet, which is above it",
               "apps/control uses fleet, but its mix.exs does not say so"
             ]

      assert Layers.problems(%{app | uses: app.uses -- [:protocols]}) == [
               "apps/control/mix.exs names protocols, which it does not use"
             ]
    end

    test "have modules of their own name", %{control: app} do
      for module <- ["Control.Made.Up", "Aerie.Vehicle.MadeUp"] do
        assert Layers.problems(%{app | modules: [module | app.modules]}) ==
                 ["apps/control: the module #{module} is named like one of another app"]
      end
    end

    test "have at most 25 arrows in their picture", %{control: app} do
      edges = for n <- 1..26, do: {path(app, ["from#{n}"]), path(app, ["to#{n}"])}
      assert Shrinking.problems(Limits.arrows([%{app | edges: tl(edges)}]), %{}) == []
      assert [problem] = Shrinking.problems(Limits.arrows([%{app | edges: edges}]), %{})
      assert problem =~ "apps/control: 26 arrows between its folders, 25 at most"
    end
  end

  describe "limits" do
    test "at most 12 files side by side" do
      files = for n <- 1..12, do: "apps/a/lib/a/#{n}.ex"
      assert Shrinking.problems(Limits.files_in_folder(["apps/a/lib/a/b/1.ex" | files]), %{}) == []

      assert Shrinking.problems(Limits.files_in_folder(["apps/a/lib/a/13.ex" | files]), %{}) ==
               [
                 "apps/a/lib/a: 13 files side by side, 12 at most; move those of one subject to a folder of its name"
               ]
    end

    test "at most 20 modules of other files that a file names", %{control: app} do
      names = for n <- 1..21, do: {:base, "Aerie.Base.Made#{n}"}
      problems = &Shrinking.problems(Limits.named([%{app | names: %{"aerie/control/made_up" => &1}}]), %{})
      assert problems.(tl(names)) == []

      assert problems.(names) == [
               "apps/control/lib/aerie/control/made_up.ex: names 21 modules of other files, 20 at most; " <>
                 "move one of its tasks to a module of its own"
             ]
    end

    test "api and console name few modules of the apps below" do
      problems = fn names ->
        app = %{name: :api, names: %{"aerie/api/made_up" => names}}
        Shrinking.problems(Limits.used([app, %{app | name: :console}]), %{})
      end

      names = for n <- 1..25, do: {:control, "Aerie.Control.Made.Up#{n}"}
      assert problems.([{:base, "Aerie.Base.Made.Up"}, {:access, "Aerie.Access.Made.Up"} | names]) == []
      assert [problem] = problems.([{:fleet, "Aerie.Fleet.Made.Up"} | names])
      assert problem =~ "apps/api, apps/console: name 26 modules of the apps below, 25 at most"
    end

    test "no line of more than 120 characters" do
      at_most = String.duplicate("µ", 120)
      assert Shrinking.problems(Limits.long_lines(%{"a.ex" => at_most <> "\n" <> at_most}), %{}) == []

      assert [problem] =
               Shrinking.problems(Limits.long_lines(%{"a.ex" => "x\n#{at_most}µ\ny\n#{at_most}µ\n"}), %{
                 "a.ex" => 1
               })

      assert problem =~ "a.ex: 2 lines of more than 120 characters, 1 at most;"
      assert problem =~ ": 2, 4"
    end
  end

  test "the lowest apps name nothing above them in documentation" do
    text = "# See `MavCodec.Frame`.\n# See `MavRouter.Link`.\n# `Camera.MavRouter.Link`\n"
    assert Layers.told(:base, "a.ex", text) == ["a.ex:2: names a module of an app above it"]
  end

  describe "firmwares" do
    test "are known by their names in their folder only" do
      named = "defmodule A do\n  def of(:px4), do: 1\nend\n"
      own = "apps/vehicle/lib/aerie/vehicle/firmware"

      places = [
        "apps/a/lib/a.ex",
        "apps/sim_vehicle/lib/a.ex",
        own <> ".ex",
        own <> "/px4/a.ex",
        own <> "s.ex"
      ]

      limit = Firmwares.limit(Map.new(places, &{&1, named}))
      assert limit.found == %{"apps/a/lib/a.ex" => 1, (own <> "s.ex") => 1}

      assert Shrinking.problems(limit, %{(own <> "s.ex") => 1}) == [
               "apps/a/lib/a.ex: names a firmware 1 times, 0 at most; move what differs into #{own}/, in lines 2"
             ]
    end

    test "are found in whichever way code knows them" do
      for code <- [
            ":ardupilot",
            "%{autopilot: :inav}",
            "[betaflight: 1]",
            "~w(px4 other)a",
            "name == \"BTFL\"",
            "text =~ ~r/^INAV /",
            "Firmware.Px4.modes()",
            "MavAutopilot.value(:MAV_AUTOPILOT_PX4)",
            "vehicle.autopilot == 12",
            "%{autopilot: 3}"
          ],
          do: assert(Firmwares.named("a = 1\n" <> code) == [2], code)

      for code <- [
            "@moduledoc \"px4\"",
            "# PX4",
            "\"PX4 has no relays\"",
            "MavCodec.Dialects.Ardupilot",
            "a.autopilot"
          ],
          do: assert(Firmwares.named(code) == [], code)
    end

    test "are named by each place that may" do
      for place <- Firmwares.elsewhere() do
        files =
          if String.ends_with?(place, "/"),
            do: Path.wildcard("../../#{place}**/*.ex"),
            else: ["../../#{place}"]

        assert Enum.any?(files, &(&1 |> File.read!() |> Firmwares.named() != [])), place
      end
    end
  end

  describe "exceptions" do
    test "allow what stands, and no more" do
      assert Shrinking.problems(limit(), %{"a" => 14, "c" => 20}) == []
      assert Shrinking.problems(limit(), %{"a" => 13, "c" => 20}) == ["a has 14, 13 at most"]
      assert Shrinking.problems(limit(), %{"c" => 20}) == ["a has 14, 12 at most"]
    end

    test "are not higher than what stands" do
      assert [problem] = Shrinking.problems(limit(), %{"a" => 15, "c" => 20})
      assert problem =~ "bin/lib/checks/exceptions/made_up.txt: 15 for a, which has 14; lower it to 14"

      for spare <- [%{"b" => 13}, %{"gone" => 13}, %{"b" => 12}] do
        assert [problem] = Shrinking.problems(limit(), Map.merge(%{"a" => 14, "c" => 20}, spare))
        assert problem =~ "; remove it"
      end
    end

    test "are lowered and never raised by --shrink" do
      assert Shrinking.shrunk(limit(), %{"a" => 15, "b" => 13, "c" => 19, "gone" => 13}) == %{
               "a" => 14,
               "c" => 19
             }
    end
  end

  describe "modules that other apps use" do
    test "another one is refused", %{apps: apps} do
      file = "aerie/api/made_up"

      made_up = fn app -> put_in(app.names[file], [{:control, "Aerie.Control.Made.Up"}]) end

      new = fn name ->
        Enum.map(apps, &if(&1.name == name, do: made_up.(&1), else: &1)) |> Readme.problems()
      end

      assert [problem] = new.(:api) -- Readme.problems(apps)

      assert problem =~
               "apps/api/lib/aerie/api/made_up.ex uses Aerie.Control.Made.Up, which apps/control/README.md"

      assert problem =~ "does not list under \"Used by other apps\"; use one that it lists, or add it there"

      # Its own, and what wires all apps.
      for name <- [:control, :aerie], do: assert(new.(name) == Readme.problems(apps))
    end

    test "one that no other app uses is refused" do
      app = %{name: :control, names: %{}}

      assert [problem] = Readme.problems([app], %{control: ["Aerie.Control.Made.Up"]})
      assert problem =~ "apps/control/README.md lists Aerie.Control.Made.Up"
      assert problem =~ "which no other app uses; remove it"
    end

    test "the list is read from the section's block" do
      text = """
      # a

      ```
      No: module
      ```

      ## Used by other apps

      Words.

      ```
      A
      A: B, C,
        D
      A.B: *
      ```
      """

      assert Readme.listed(text) == ~w(A A.B A.C A.D A.B.*)
      assert Readme.listed("# a\n") == []
    end
  end

  test "the names of modules in a file are whole" do
    text = ~S'''
    defmodule A.B do
      use A.Used
      alias A.{C, D.E}
      alias C.F, as: G
      alias __MODULE__.Own
      @spec f(A.Type.t()) :: term()
      def f(x), do: [E.f(x), G.H.f(x), %Own{}, &Enum.map/2, "#{A.Text.f(x)}"]
    end
    '''

    assert text |> Source.named() |> Enum.sort() ==
             ~w(A.B A.B.Own A.C A.C.F A.C.F.H A.D.E A.Text A.Type A.Used Enum)
  end

  defp limit do
    found = %{"a" => 14, "b" => 12, "c" => 20}
    %{name: :made_up, most: 12, found: found, problem: &"#{&1} has #{&2}, #{&3} at most"}
  end

  defp new_folder_cycles(app, edges), do: folder_cycles(%{app | edges: edges}) -- folder_cycles(app)
  defp folder_cycles(app), do: Shrinking.problems(Limits.folder_cycles([app]), %{})
  defp path(app, parts), do: Path.join(app.main ++ parts)
  defp arrow(app), do: {path(app, ["a"]), path(app, ["b"])}
end
