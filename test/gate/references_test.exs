Code.require_file("../../bin/lib/checks/references.exs", __DIR__)

defmodule Aerie.Gate.ReferencesTest do
  use ExUnit.Case, async: true

  @wing """
  defmodule Kite.Wing do
    @moduledoc "A wing."
    use Kite.Sail

    @type size :: float()
    @callback trim(t(), float()) :: t()
    defstruct [:span, area: 1.0]

    def fold(wing, by \\\\ 1), do: {wing, by}
    defp crease(wing), do: wing
  end
  """
  @sail """
  defmodule Kite.Sail do
    defmacro __using__(_options) do
      quote do
        def hoist(sail), do: sail
      end
    end
  end
  """
  @sources [
    {"apps/kite/lib/kite/wing.ex", @wing},
    {"apps/kite/lib/kite/sail.ex", @sail},
    {"apps/kite/lib/kite/tail/knot.ex", "defmodule Kite.Tail.Knot do\nend"},
    {"apps/kite/lib/ship/winch.ex", "defmodule Ship.Winch do\nend"}
  ]

  # What is wrong in a module with this documentation, or on a page with this text.
  defp in_doc(text),
    do: check("apps/kite/lib/kite/tail.ex", "defmodule Kite.Tail do\n  @moduledoc \"#{text}\"\nend")

  defp check(file, source), do: References.check([{file, source} | @sources], [], fn _path -> false end)

  defp on_page(text, page \\ "docs/kite.md"),
    do: References.check(@sources, [{page, text}], &(&1 == "docs/rope.md"))

  test "a module that does not exist is found, with and without its first names" do
    assert in_doc("See `Kite.Rudder`.") == ["apps/kite/lib/kite/tail.ex:2: Kite.Rudder does not exist"]
    assert in_doc("See `Tail.Rudder`.") == ["apps/kite/lib/kite/tail.ex:2: Tail.Rudder does not exist"]
    assert on_page("\nSee `Anchor.Chain`.") == ["docs/kite.md:2: Anchor.Chain does not exist"]
  end

  test "a module by its whole name, its last names, or the name of a folder of modules" do
    assert in_doc("`Kite.Wing`, `Tail.Knot`, `Kite.Tail`, `%Kite.Wing{}`, `Ship.*`") == []
    assert on_page("`GenServer`, `Task.Supervisor`, `ATTITUDE.roll`, `kite.cpp`, `MyApp.Dialect`") == []
    assert on_page("`MavCodec.Messages.Heartbeat`, `MavCodec.Enums.MavCmd.params/1`") == []
  end

  test "a module that is elsewhere in the app needs more than its last name in documentation" do
    assert [message] = in_doc("| `Winch` | pulls |")
    assert message =~ "tail.ex:2: Winch is not in this folder: write more of its name (Ship.Winch)"
    assert in_doc("| `Knot`, `Ship.Winch`, `Host` |") == []

    assert check("apps/kite/lib/kite/tail.ex", "defmodule Kite.Tail do\n  # `Winch`\n  alias Ship.Winch\nend") ==
             []
  end

  test "a function that its module does not have is found, by its arity or its name" do
    assert on_page("`Kite.Wing.flap/1`") == ["docs/kite.md:1: Kite.Wing.flap/1 does not exist"]
    assert on_page("`Wing.fold/3`") == ["docs/kite.md:1: Wing.fold/3 does not exist"]
    assert on_page("`Wing.flap`") == ["docs/kite.md:1: Wing.flap does not exist"]
    assert on_page("`Pipe.open`") == ["docs/kite.md:1: Pipe.open does not exist"]
    assert on_page("`String.reverse/9`") == ["docs/kite.md:1: String.reverse/9 does not exist"]
    assert on_page("`t:Kite.Wing.weight/0`") == ["docs/kite.md:1: Kite.Wing.weight/0 does not exist"]
  end

  test "functions, types, callbacks, fields, and what a module gets by use" do
    assert on_page(
             "`Kite.Wing.fold/1`, `&Wing.fold/2`, `Wing.fold`, `Wing.span`, `Wing.area`, `Wing.hoist/1`"
           ) == []

    assert on_page(
             "`t:Kite.Wing.size/0`, `c:Wing.trim/2`, `String.trim/1`, `System.monotonic_time/1`, `Wing.crease/1`"
           ) == []
  end

  test "calls of examples are looked up in documentation" do
    text = """
    defmodule Kite.Tail do
      @moduledoc \"\"\"
      A tail:

          Wing.fold(wing)
          Pipe.open(wing)
      \"\"\"
    end
    """

    assert check("apps/kite/lib/kite/tail.ex", text) == [
             "apps/kite/lib/kite/tail.ex:6: Pipe.open does not exist"
           ]

    assert on_page("```\nWing.flap(wing)\nEnum.map(a, b)\n```") == [
             "docs/kite.md:2: Wing.flap does not exist"
           ]
  end

  test "a function without a module is one of the module, of the README's folder, or of Elixir" do
    assert [message] = in_doc("Call `fold/1`.")
    assert message =~ "tail.ex:2: fold/1 does not exist here: write Module.fold/1 if another module has it"
    assert in_doc("`send/2`, `handle_info/2`, `main/7`") == []
    assert on_page("`fold/2`", "apps/kite/README.md") == []
    assert on_page("`fold/2`", "apps/kite/lib/kite/wing/README.md") == []
    assert on_page("`fold/2`") == []

    assert ["apps/kite/lib/kite/tail/README.md:1: fold/2" <> _] =
             on_page("`fold/2`", "apps/kite/lib/kite/tail/README.md")

    assert ["docs/kite.md:1: flap/2" <> _] = on_page("`flap/2`")
  end

  test "tests, files and links of a page" do
    assert on_page("`glide_test`, `lib/glide.ex`, [a](glide.md)") ==
             for(name <- ~w(glide.md glide_test lib/glide.ex), do: "docs/kite.md:1: #{name} does not exist")

    assert on_page("`motor_test`, `kite/wing.ex`, [a](rope.md#knots), [b](https://example.org)") == []
  end

  test "a test module is named as its file" do
    empty = fn name -> "defmodule #{name} do\nend" end

    assert [message] = check("apps/kite/test/kite/wing_test.exs", empty.("Kite.FlapTest"))
    assert message =~ "wing_test.exs:1: the test module Kite.FlapTest is not named as its file: Kite.WingTest"

    assert [message] = check("test/system/wing_test.exs", empty.("Kite.WingTest"))
    assert message =~ "the test module Kite.WingTest is not named as its file: Aerie.System.WingTest"

    assert check("apps/kite/test/kite/http_port_test.exs", empty.("Kite.HTTPPortTest")) == []
    assert check("apps/kite_line/test/winch_test.exs", empty.("KiteLine.WinchTest")) == []
    assert check("test/system/wing_test.exs", empty.("Aerie.System.WingTest")) == []
    assert check("apps/kite/test/support/wind.ex", empty.("Kite.Gust")) == []
  end

  test "names in tests of checks are made up" do
    source = fn module -> "defmodule #{module} do\n  # `Kite.Rudder`\nend" end
    assert check("test/gate/wind_test.exs", source.("Aerie.Gate.WindTest")) == []
    assert [_problem] = check("test/system/wind_test.exs", source.("Aerie.System.WindTest"))
  end
end
