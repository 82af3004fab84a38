defmodule Aerie.CLI.ParserTest do
  use ExUnit.Case, async: true

  alias Aerie.CLI.{Help, Parser, Subcommand, Subcommands}
  alias Aerie.CLI.Help.About

  test "every row of the table has a module that does it, help, completion and a place in the man page" do
    {0, man} = About.run(%{name: "man", rows: Subcommands.all()})
    {0, bash} = About.run(%{name: "completion", rows: Subcommands.all()})
    all = Help.text(Subcommands.all())

    for row <- Subcommands.all() do
      assert row.where == :script or
               (Code.ensure_loaded?(row.module) and function_exported?(row.module, :run, 1)),
             row.name

      assert all =~ row.name
      assert bash =~ row.name |> String.split() |> hd()
      assert man =~ ".SS aerie #{String.replace(row.name, "-", "\\-")}"
      help = Help.text(row)
      assert help =~ "usage: aerie #{row.name}"
      for {name, _kind, _placeholder, _meaning} <- row.options, do: assert(help =~ Subcommand.switch(name))
      assert {:help, found} = Parser.command_line(String.split(row.name) ++ ["--help"])
      assert found.name == row.name
    end

    assert for(line <- String.split(all, "\n"), String.length(line) > 100, do: line) == []
  end

  test "bin/lib/help.txt is the help of today's table" do
    file = Path.expand("../../../../../bin/lib/help.txt", __DIR__)
    assert File.read!(file) == Help.file(Subcommands.all()), "mix aerie.help in apps/aerie writes it"
  end

  test "words become a request" do
    assert {:ok, %{name: "rpc"}, %{"EXPRESSION" => "1 + 1"}, %{gateway: "aerie-7"}} =
             Parser.command_line(["rpc", "1 + 1", "--gateway", "aerie-7"])

    assert {:ok, %{name: "config check"}, %{"FILE" => "g.yaml"}, %{}} =
             Parser.command_line(["config", "check", "g.yaml"])

    assert {:ok, _row, arguments, %{}} = Parser.command_line(["config", "check"])
    assert arguments == %{}
    assert {:ok, _row, %{"NAME=VALUE" => []}, %{}} = Parser.command_line(["cmd", "v", "arm"])

    assert {:ok, %{name: "cmd"}, %{"VEHICLE" => "v", "TYPE" => "goto", "NAME=VALUE" => ["lat=-1", "lon=2"]},
            %{yes: true}} =
             Parser.command_line(["cmd", "v", "goto", "lat=-1", "--yes", "lon=2"])

    assert {:ok, _row, %{"VALUE" => "-5"}, %{}} = Parser.command_line(["params", "set", "v", "ANGLE", "-5"])

    assert {:error, "config: expected config check, config show; see aerie config --help"} =
             Parser.command_line(["config"])

    for help <- ["--help", "-h", "help"],
        do:
          assert(
            {:help, [%{name: "config check"}, %{name: "config show"}]} = Parser.command_line(["config", help])
          )

    assert {:help, [_ | _]} = Parser.command_line([])
    assert {:help, [_ | _]} = Parser.command_line(["--help"])
    assert {:help, %{name: "start"}} = Parser.command_line(["start", "--link", "x"])
  end

  test "what is wrong is said, with what was probably meant" do
    assert {:error, "unknown command stpo; did you mean stop?" <> _} = Parser.command_line(["stpo"])
    assert {:error, "unknown command qqq; aerie --help" <> _} = Parser.command_line(["qqq"])

    assert {:error, "stop: unknown option --gatewy; did you mean --gateway?" <> _} =
             Parser.command_line(["stop", "--gatewy", "x"])

    assert {:error, "stop: --gateway needs a value" <> _} = Parser.command_line(["stop", "--gateway"])
    assert {:error, "stop: unexpected 'now'" <> _} = Parser.command_line(["stop", "now"])
    assert {:error, "rpc: EXPRESSION is missing: aerie rpc EXPRESSION" <> _} = Parser.command_line(["rpc"])
  end

  @tag :tmp_dir
  test "bash completes commands and options", %{tmp_dir: folder} do
    file = Path.join(folder, "completion")
    {0, script} = About.run(%{name: "completion", rows: Subcommands.all()})
    File.write!(file, script)

    complete = fn words ->
      script = """
      . ./completion; COMP_WORDS=(#{Enum.map_join(words, " ", &"'#{&1}'")}); COMP_CWORD=#{length(words) - 1}
      _aerie; printf '%s\\n' "${COMPREPLY[@]}"
      """

      {text, 0} = System.cmd("bash", ["-c", script], cd: folder)
      String.split(text, "\n", trim: true)
    end

    assert "stop" in complete.(["aerie", "st"])
    refute "rpc" in complete.(["aerie", "st"])
    assert complete.(["aerie", "stop", "--g"]) == ["--gateway"]
    assert complete.(["aerie", "rpc", "x", "--h"]) == ["--help"]
  end
end
