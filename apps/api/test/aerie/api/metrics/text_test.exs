defmodule Aerie.Api.Metrics.TextTest do
  use ExUnit.Case, async: true

  alias Aerie.Api.Metrics.Text

  test "a family has its help, its type and a line for each sample" do
    families = [{"gateway_link_up", :gauge, "Whether it is up.", [{[link: "a"], true}, {[link: "b"], false}]}]

    assert IO.iodata_to_binary(Text.render(families)) == """
           # HELP gateway_link_up Whether it is up.
           # TYPE gateway_link_up gauge
           gateway_link_up{link="a"} 1
           gateway_link_up{link="b"} 0
           """
  end

  test "labels are escaped, so that a vehicle's name cannot forge a line" do
    families = [{"x", :counter, "h", [{[name: "a\"} 1\n\\evil"], 2.5}]}]
    assert IO.iodata_to_binary(Text.render(families)) =~ ~S(x{name="a\"} 1\n\\evil"} 2.5)
  end

  test "unknown samples are left out, and so are families without known samples" do
    families = [{"x", :gauge, "h", [{[], nil}]}, {"y", :gauge, "h", [{[a: 1], nil}, {[a: 2], 3}]}]
    text = IO.iodata_to_binary(Text.render(families))
    refute text =~ "x"
    refute text =~ ~s(a="1")
    assert text =~ ~s(y{a="2"} 3)
  end
end
