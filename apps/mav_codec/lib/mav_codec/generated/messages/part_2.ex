defmodule MavCodec.Generated.Messages.Part2 do
  use MavCodec.Definition.Shard, messages: {2, 8}
end
