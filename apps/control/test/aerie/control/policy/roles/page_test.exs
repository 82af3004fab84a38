defmodule Aerie.Control.Policy.Roles.PageTest do
  use ExUnit.Case, async: true

  test "docs/policy.md and docs/security.md say who can do what as the tables do (mix aerie.authority)" do
    for {file, page} <- Mix.Tasks.Aerie.Authority.pages(), do: assert(File.read!(file) == page, file)
  end

  test "config/gateway.example.yaml says what a client without an entry may do" do
    {:ok, policy} = Aerie.Control.Policy.compile(%{})
    origin = %{owner: "id", text: nil, principal: nil, commands: true, side: :client, auto: false}
    unlisted = &Aerie.Control.Policy.principal(policy, Map.put(origin, :local, &1))
    [here, beyond] = Enum.map([true, false], unlisted)
    writes = if :maintain in here.may, do: "writes", else: "writes no"
    file = Path.expand("../../../../../../../config/gateway.example.yaml", __DIR__)
    text = file |> File.read!() |> String.replace(~r/\s*\n\s*#\s*/, " ")

    assert text =~
             "is an #{here.role} on this machine (it #{writes} parameters), and a #{beyond.role} beyond it."

    refute text =~ "A client that no entry names, by its id or by one without an id, may do"
  end
end
