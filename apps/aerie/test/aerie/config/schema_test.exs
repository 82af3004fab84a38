defmodule Aerie.Config.SchemaTest do
  use ExUnit.Case, async: true

  alias Aerie.Config.{Environment, Error, Example, Keys, Yaml}
  alias Aerie.Base.Settings.{Field, Schema}

  @example Path.expand("../../../../../config/gateway.example.yaml", __DIR__)

  test "config/gateway.example.yaml is what the schema generates (mix aerie.config.example)" do
    assert File.read!(@example) == Example.yaml()
  end

  @tag :tmp_dir
  test "the task writes it", %{tmp_dir: dir} do
    file = Path.join(dir, "example.yaml")
    ExUnit.CaptureIO.capture_io(fn -> Mix.Tasks.Aerie.Config.Example.run([file]) end)
    assert File.read!(file) == Example.yaml()
  end

  test "a secret shows as one" do
    secret = Aerie.Base.Secret.new("hunter2")
    assert inspect(secret) == "#Aerie.Base.Secret<hidden>"
    assert Aerie.Base.Secret.reveal(secret) == "hunter2"
    assert Aerie.Base.Secret.reveal(nil) == nil
    assert_raise Protocol.UndefinedError, fn -> JSON.encode!(secret) end
  end

  test "the example as it is means the defaults" do
    {:ok, raw} = Yaml.parse(Example.yaml())
    assert {values, []} = Schema.validate(Keys.fields(), raw)
    assert values == Schema.defaults(Keys.fields())
    assert {:ok, config} = Aerie.Config.load(@example, [], env: %{})
    assert %{config | file: nil, lines: %{}} == Aerie.Config.default()
  end

  test "the example with every key taken in loads too, and names every key" do
    text = Regex.replace(~r/^( *)#([a-z0-9_]+: )/m, Example.yaml(), "\\1\\2")
    assert {:ok, raw} = Yaml.parse(text)
    assert {values, []} = Schema.validate(Keys.fields(), raw)

    for {path, %Field{example: nil} = field} <- Schema.leaves(Keys.fields()) do
      assert get_in(values, Enum.map(path, &String.to_existing_atom/1)) == field.default
    end

    for {path, _field} <- Schema.leaves(Keys.fields()),
        do: assert(get_in(raw, path) != nil, Enum.join(path, "."))
  end

  test "every default is valid for its type" do
    for {path, %Field{default: default} = field} <- Schema.leaves(Keys.fields()), default not in [nil, []] do
      assert {_, []} = Schema.validate([field], %{Field.name(field) => as_yaml(default)}),
             Enum.join(path, ".")
    end
  end

  test "every key has a variable of its own and a meaning" do
    names = for {path, _} <- Schema.leaves(Keys.fields()), do: Environment.name(path)
    assert Enum.uniq(names) == names
    assert "AERIE_NATS_URL" in names

    for {path, field} <- Schema.leaves(Keys.fields()), not match?(["sampling", "groups" | _], path) do
      assert String.length(field.doc) > 4, Enum.join(path, ".")
    end
  end

  test "the state groups are those of a vehicle" do
    assert Enum.sort(Map.keys(Aerie.Vehicle.State.Sampling.Settings.groups(%{}))) ==
             Enum.sort(Keyword.keys(Aerie.Vehicle.State.Groups.keys()))
  end

  test "no problem is a bare inspect of something" do
    everything_wrong = Map.new(Keys.fields(), &{Field.name(&1), %{"x" => {:odd, self()}}})
    {_values, problems} = Schema.validate(Keys.fields(), everything_wrong)
    assert length(problems) > 10

    for problem <- problems do
      error = struct!(Error, Map.put(problem, :file, "f") |> Map.update!(:path, &Error.path/1))
      refute to_string(error) =~ ~r/#PID|%\{|:odd/
    end
  end

  test "any tree of plain values gives values or problems, never a crash" do
    scalar =
      :proper_types.oneof([:proper_types.integer(), :proper_types.float(), "abc", "", nil, true, "1", "*"])

    name =
      :proper_types.oneof(
        Enum.map(Keys.fields(), &Field.name/1) ++ ["url", "id", "groups", "gps", "port", "zz"]
      )

    tree =
      :proper_types.sized(fn size -> tree(min(size, 4), scalar, name) end)

    property =
      :proper.forall(tree, fn raw ->
        {values, problems} = Schema.validate(Keys.fields(), raw)
        is_map(values) and Enum.all?(problems, &is_list(&1.path))
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 300]) == true, inspect(:proper.counterexample())
  end

  defp tree(0, scalar, _name), do: scalar

  defp tree(depth, scalar, name) do
    below = :proper_types.lazy(fn -> tree(depth - 1, scalar, name) end)
    pairs = :proper_types.list(:proper_types.tuple([name, below]))
    map = :proper_types.bind(pairs, &Map.new/1, false)
    :proper_types.oneof([scalar, :proper_types.list(below), map])
  end

  defp as_yaml(atom) when is_atom(atom) and not is_boolean(atom), do: Atom.to_string(atom)
  defp as_yaml(list) when is_list(list), do: Enum.map(list, &as_yaml/1)
  defp as_yaml(value), do: value
end
