defmodule Aerie.Control.Policy.PageTest do
  use ExUnit.Case, async: true

  test "docs/policy.md and docs/security.md say who can do what as the tables do (mix aerie.authority)" do
    for {file, page} <- Mix.Tasks.Aerie.Authority.pages(), do: assert(File.read!(file) == page, file)
  end
end
