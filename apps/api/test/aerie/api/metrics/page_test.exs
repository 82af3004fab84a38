defmodule Aerie.Api.Metrics.PageTest do
  use ExUnit.Case, async: true

  alias Aerie.Api.Metrics.Page

  @page Path.expand("../../../../../../docs/metrics.md", __DIR__)

  test "docs/metrics.md is what the code says; mix aerie.metrics writes it" do
    assert File.read!(@page) == Page.markdown()
  end

  test "each family has a name of its own and a meaning that fits a cell" do
    names = for {name, _type, _help} <- Page.known(), do: name
    assert length(names) > 90
    assert names == Enum.uniq(names)

    for {name, type, help} <- Page.known() do
      assert name =~ ~r/\Agateway_[a-z_]+\z/
      assert type == :counter == String.ends_with?(name, "_total"), name
      assert help =~ ~r/\A[^|\n]+\.\z/, name
    end
  end
end
