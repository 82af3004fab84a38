defmodule Aerie.Gate.RefusalsTest do
  @moduledoc "Every rule by which something is refused has a row in the table of refusals, and every row is used."
  use ExUnit.Case, async: true

  alias Aerie.Control.Policy
  alias Aerie.Vehicle.Command.Refusal

  @apps Path.expand("../../apps", __DIR__)
  @forms [
    ~r/\{:deny, :([a-z_]+)/,
    ~r/\{:stop, :[a-z]+, :([a-z_]+)/,
    ~r/\{:refuse, :(?:(?:denied|rejected), :)?([a-z_]+)/,
    # Not a call of an Erlang module.
    ~r/\{:refused, :((?!rejected|failed)[a-z_]++)(?!\.)/,
    ~r/refuse\(core, :[a-z]+, :([a-z_]+)/,
    ~r/"rule" => "([a-z_]+)"/,
    ~r/unrecorded\(ctx, :([a-z_]+)/,
    ~r/refusal\((?:%\{\}, )?:([a-z_]+), /,
    ~r/refuse\(request, :([a-z_]+), /
  ]
  # The console's own: a form that is not complete, and what a firmware lacks, before a command is given.
  @console ~w(form firmware)

  defp used do
    for file <- Path.wildcard(@apps <> "/{control,fleet,access,api,console,vehicle}/lib/**/*.ex"),
        text = File.read!(file),
        form <- @forms,
        [_all, rule] <- Regex.scan(form, text),
        uniq: true,
        do: rule
  end

  test "rules and rows" do
    rows = for row <- Refusal.table(), do: Atom.to_string(row.rule)
    assert rows == Enum.uniq(rows)
    used = Enum.uniq(used() ++ Enum.map(Policy.rules(), &Atom.to_string/1)) -- @console
    assert Enum.sort(used -- rows) == []
    # That each text of a row is used somewhere is a test of the table.
    textless = for %{texts: [], rule: rule} <- Refusal.table(), do: Atom.to_string(rule)
    assert Enum.sort(textless -- used) == []
  end

  test "each row says what it means and what to do" do
    for %{rule: rule, by: by, http: http, means: means, fix: fix} <- Refusal.table() do
      assert by != "" and http in [nil | Enum.to_list(400..599)]
      assert {rule, true} == {rule, means =~ ~r/\A\p{L}.*[^.]\z/u and fix =~ ~r/\A\p{Ll}.*[^.]\z/u}
    end
  end
end
